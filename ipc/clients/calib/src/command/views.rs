//! Views, from a folder or as they come.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use program::Exit;
use vpc_camera::grey::Grey;

use crate::arguments::ImageArguments;
use crate::command::Failure;
use crate::detector::Detector;
use crate::live::{self, News};
use crate::picture::{self, Picture};
use crate::pose_file;
use crate::still::{LATE, Still};
use crate::target::Target;
use crate::view::View;

/// Views of images of one size.
#[derive(Default)]
pub struct Views {
    /// Each view, with the joints of the arm where they were taken with one.
    pub views: Vec<(View, Option<[f64; 7]>)>,
    /// Width and height of the images, px.
    pub size: [u32; 2],
}

/// The images of a folder.
pub fn of_folder(folder: &Path, detector: &mut Detector) -> Result<Views, Failure> {
    let mut views = Vec::new();
    let mut first: Option<(PathBuf, [u32; 2])> = None;
    for path in picture::folder(folder)? {
        let picture = Picture::read(&path)?;
        let (known, size) = first.get_or_insert_with(|| (path.clone(), picture.size));
        if *size != picture.size {
            return Err(Failure::new(
                Exit::Config,
                format!(
                    "{}: {}x{} px; allowed: {}x{} px, as {}: all images from one camera, at one size",
                    path.display(),
                    picture.size[0],
                    picture.size[1],
                    size[0],
                    size[1],
                    known.display()
                ),
            ));
        }
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let Some(grey) = picture.grey() else { continue };
        let view = detector.view(&name, &grey)?;
        eprintln!("{name}: {} corners", view.points.len());
        views.push((view, None));
    }
    let size = first.map_or([0; 2], |(_, size)| size);
    Ok(Views { views, size })
}

/// Takes a view whenever nothing moves, until there are enough or `stop` is set.
pub fn of_camera(
    arguments: &ImageArguments,
    detector: Detector,
    target: &Target,
    wants_robot: bool,
    stop: &AtomicBool,
) -> Result<Views, Failure> {
    let mut taker = Taker {
        detector,
        folder: Folder::new(arguments.save.as_deref())?,
        still: None,
        joints: None,
        age: None,
        is_told: false,
        taken: Views::default(),
    };
    let wanted = arguments.views as usize;
    eprintln!(
        "show the board in another way each time, and keep still for a second: {wanted} views"
    );
    let begin = Instant::now();
    let mut failed = None;
    live::watch(&arguments.stream, stop, |news| {
        let image = match news {
            News::Robot(sample) => {
                taker.arm(sample.q);
                return true;
            }
            News::Image { image, time } => {
                taker.age = time.map(|time| 1e-9 * ipc::now_ns() as f64 - time);
                image
            }
        };
        let now = begin.elapsed().as_secs_f64();
        if !wants_robot || taker.joints.is_some() {
            failed = taker.look(&image, now, target).err();
        }
        failed.is_none() && taker.taken.views.len() < wanted
    })?;
    match failed {
        Some(error) => Err(error),
        None if wants_robot && taker.joints.is_none() => Err(Failure::new(
            Exit::Unavailable,
            "no joints on vpc/robot; is the bridge at work?",
        )),
        None => Ok(taker.taken),
    }
}

/// Takes views as images come.
struct Taker {
    detector: Detector,
    folder: Folder,
    still: Option<Still>,
    joints: Option<[f64; 7]>,
    /// Of the image, s, if its stamp tells.
    age: Option<f64>,
    /// Whether it was said that images are old.
    is_told: bool,
    taken: Views,
}

impl Taker {
    fn arm(&mut self, q: [f64; 7]) {
        self.joints = Some(q);
        if let Some(still) = &mut self.still {
            still.arm(&pose_file::flange(q));
        }
    }

    fn look(&mut self, image: &Grey, now: f64, target: &Target) -> Result<(), Failure> {
        let name = format!("{:03}.png", self.taken.views.len());
        let mut view = self.detector.view(&name, image)?;
        view.keep_known(target);
        let size = [image.width(), image.height()].map(|side| side as u32);
        self.taken.size = size;
        let still = self.still.get_or_insert_with(|| Still::new(size[0]));
        if let Some(age) = self.age.filter(|age| *age > LATE) {
            if !std::mem::replace(&mut self.is_told, true) {
                eprintln!("images are {age:.1} s old; no view is taken of any older than {LATE} s");
            }
            still.miss();
            return Ok(());
        }
        if still.take(now, &view) {
            eprintln!("taken {}: {} corners", still.count(), view.points.len());
            self.folder.add(&name, image, self.joints.as_ref())?;
            self.taken.views.push((view, self.joints));
        }
        Ok(())
    }
}

/// Where views are saved to.
struct Folder {
    path: Option<PathBuf>,
    poses: String,
}

impl Folder {
    fn new(path: Option<&Path>) -> Result<Self, Failure> {
        if let Some(path) = path {
            std::fs::create_dir(path).map_err(|error| {
                Failure::new(Exit::CannotCreate, format!("{}: {error}", path.display()))
            })?;
        }
        Ok(Self {
            path: path.map(Path::to_owned),
            poses: pose_file::HEADER.to_owned(),
        })
    }

    fn add(&mut self, name: &str, image: &Grey, q: Option<&[f64; 7]>) -> Result<(), Failure> {
        let Some(folder) = &self.path else {
            return Ok(());
        };
        Picture::of(image)
            .write(&folder.join(name))
            .map_err(|error| Failure::new(Exit::CannotCreate, error))?;
        if let Some(q) = q {
            self.poses += &pose_file::line(name, q);
            let path = folder.join("poses.csv");
            std::fs::write(&path, &self.poses).map_err(|error| {
                Failure::new(Exit::CannotCreate, format!("{}: {error}", path.display()))
            })?;
        }
        Ok(())
    }
}
