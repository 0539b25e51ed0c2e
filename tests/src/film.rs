//! A film of a run: the camera's images, and over them what the controller knows.

use std::path::{Path, PathBuf};

use figures::{Animation, Photo, Points, View};
use ipc::{Domain, Image, ImageSubscriber, Subscriber};
use messages::{CycleRecord, Features};
use scene::Scene;

/// Images from one of the film to the next.
const EVERY: u64 = 9;
/// Time that each stands, s, and the last one.
const STANDS_S: [f64; 2] = [0.1, 2.0];

/// An image of the film.
struct Shot {
    photo: Photo,
    /// Places of the path so far.
    path: usize,
    visible: u32,
    foreseen: Vec<Points>,
    words: String,
}

/// A film in the making.
pub struct Film {
    scene: Scene,
    goal: Points,
    images: ImageSubscriber,
    features: Subscriber<Features>,
    cycles: Subscriber<CycleRecord>,
    /// The next image to be taken, and the one that waits for its features.
    next: u64,
    waiting: Option<(u64, Photo)>,
    path: Vec<Points>,
    foreseen: Vec<Points>,
    shots: Vec<Shot>,
}

impl Film {
    /// A film of what happens in a domain from now on, in this scene.
    ///
    /// # Errors
    /// A service takes no more subscribers, or the scene's goal is behind the camera.
    pub fn open(domain: &Domain, scene: Scene) -> anyhow::Result<Self> {
        let goal = hw_sim::camera::project(&scene, &hw_sim::pose::from_scene(&scene.goal))?;
        Ok(Self {
            goal: goal.to_vec(),
            scene,
            images: domain.image_subscriber()?,
            features: domain.subscriber(usize::MAX)?,
            cycles: domain.subscriber(usize::MAX)?,
            next: 0,
            waiting: None,
            path: Vec::new(),
            foreseen: Vec::new(),
            shots: Vec::new(),
        })
    }

    /// Takes in what has come.
    ///
    /// # Errors
    /// A message or an image is refused.
    pub fn look(&mut self) -> anyhow::Result<()> {
        if let Some(image) = self.images.latest()? {
            let number = image.header().stamp.sequence;
            if number >= self.next && self.waiting.is_none() {
                self.waiting = Some((number, photo(&image)));
                self.next = number + EVERY;
            }
        }
        while let Some(cycle) = self.cycles.oldest()? {
            let ways = cycle.foreseen().map(Iterator::collect);
            self.foreseen = ways.collect();
        }
        while let Some(features) = self.features.oldest()? {
            self.path.push(features.pairs().collect());
            let number = features.stamp.sequence;
            let Some((_, photo)) = self.waiting.take_if(|(waiting, _)| *waiting <= number) else {
                continue;
            };
            let seconds = number as f64 / self.scene.camera.rate_hz;
            self.shots.push(Shot {
                photo,
                path: self.path.len(),
                visible: features.visible,
                foreseen: self.foreseen.clone(),
                words: format!("{seconds:4.1} s"),
            });
        }
        Ok(())
    }

    /// Writes the film as `path`.gif.
    ///
    /// # Errors
    /// There is nothing to show, or the file cannot be written.
    pub fn write(&self, path: &Path) -> anyhow::Result<PathBuf> {
        let frames = self.shots.iter().map(|shot| {
            let view = View {
                scene: &self.scene,
                photo: shot.photo.clone(),
                path: &self.path[..shot.path],
                visible: shot.visible,
                goal: &self.goal,
                foreseen: shot.foreseen.clone(),
                words: shot.words.clone(),
            };
            view.canvas()
        });
        let [period_s, last_s] = STANDS_S;
        let animation = Animation {
            frames: frames.collect(),
            period_s,
            last_s,
        };
        Ok(animation.write(path)?)
    }
}

/// What `hw-sim` sends is grey.
fn photo(image: &Image) -> Photo {
    Photo {
        width: image.header().width as usize,
        levels: image.rows().flatten().copied().collect(),
    }
}
