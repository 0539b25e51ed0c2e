//! Recorded images in a camera's place: a folder of pictures, or a video.

mod picture;
mod y4m;

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use self::picture::Picture;
use self::y4m::Video;
use super::{Frame, Next, Source, SourceError};
use crate::grey::Grey;

/// How long to sleep before looking at the stop flag again.
const LOOK_NS: u64 = 20_000_000;

/// Where the images come from.
enum Images {
    /// Files in the order of their names, the last one first.
    Folder(Vec<PathBuf>),
    Video(Box<Video>),
}

impl Images {
    /// The next image.
    fn next(&mut self) -> Result<Option<Picture>, SourceError> {
        match self {
            Self::Folder(files) => files.pop().map(|file| Picture::read(&file)).transpose(),
            Self::Video(video) => video.next(),
        }
    }
}

/// Recorded images, stamped as if a camera took them now.
///
/// A folder's images are its files whose names end in `.png` or `.pgm`, in the order of their names
/// (so `frame10.png` comes before `frame2.png`, but after `frame02.png`). A video is a file whose name
/// ends in `.y4m`; `ffmpeg -i FILE -pix_fmt gray OUT.y4m` makes one of any other.
pub struct Replay {
    name: String,
    images: Images,
    size: [u32; 2],
    period_ns: Option<u64>,
    sequence: u64,
    next: Option<Picture>,
    now: Picture,
    /// When the next image is due.
    due_ns: u64,
}

impl fmt::Debug for Replay {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Replay").field(&self.name).finish()
    }
}

impl Replay {
    /// Opens a folder or a video, to be replayed at this rate, or as fast as it is taken.
    ///
    /// # Errors
    /// It cannot be read, has no images, or the first image is of a kind that is not taken.
    pub fn open(path: &Path, rate_hz: Option<f64>) -> Result<Self, SourceError> {
        let name = path.display().to_string();
        if let Some(rate) = rate_hz.filter(|rate| !(0.001..=10_000.0).contains(rate)) {
            let found = format!("a rate of {rate} Hz");
            return Err(SourceError::value(&name, found, "0.001 to 10000 Hz"));
        }
        let mut images = match path.is_dir() {
            true => Images::Folder(listed(path)?),
            false if is_named(path, &["y4m"]) => Images::Video(Box::new(Video::open(path)?)),
            false => {
                let allowed = "a folder of .png and .pgm files, or a file .y4m";
                return Err(SourceError::value(&name, "not a recording", allowed));
            }
        };
        let Some(first) = images.next()? else {
            let allowed = "at least one image (.png or .pgm in a folder)";
            return Err(SourceError::value(&name, "no images", allowed));
        };
        Ok(Self {
            name,
            images,
            size: first.size,
            period_ns: rate_hz.map(|rate| (1e9 / rate) as u64),
            sequence: 0,
            next: Some(first),
            now: Picture::default(),
            due_ns: 0,
        })
    }

    /// Sleeps until an image is due; false if `stop` is set before.
    fn wait(&self, stop: &AtomicBool) -> bool {
        loop {
            if stop.load(Ordering::Relaxed) {
                return false;
            }
            match self.due_ns.saturating_sub(ipc::now_ns()) {
                0 => return true,
                left => std::thread::sleep(Duration::from_nanos(left.min(LOOK_NS))),
            }
        }
    }
}

impl Source for Replay {
    fn next(&mut self, stop: &AtomicBool) -> Result<Next<'_>, SourceError> {
        Ok(self.next(stop)?.map_or(Next::End, Next::Frame))
    }
}

impl Replay {
    /// Width and height of the images, px.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Waits for the next frame. `None` at the end, or soon after `stop` is set.
    ///
    /// # Errors
    /// [`SourceError`]: an image cannot be read, or has another size.
    pub fn next(&mut self, stop: &AtomicBool) -> Result<Option<Frame<'_>>, SourceError> {
        // Decoded before it is due, so that its stamp is not of the time before decoding.
        if self.next.is_none() {
            self.next = self.images.next()?;
        }
        let Some(next) = self.next.take() else {
            return Ok(None);
        };
        if next.size != self.size {
            let [[width, height], [w, h]] = [next.size, self.size];
            let found = format!("an image of {width}x{height} px");
            let allowed = format!("{w}x{h} px, as the first one");
            return Err(SourceError::value(next.name, found, allowed));
        }
        self.now = next;
        if !self.wait(stop) {
            return Ok(None);
        }
        let now_ns = ipc::now_ns();
        // From image to image: one that is late shifts those after it, and loses none.
        self.due_ns = self.period_ns.map_or(0, |period| match self.due_ns {
            due if due + period > now_ns => due + period,
            _ => now_ns + period,
        });
        self.sequence += 1;
        let [width, height] = self.size.map(|side| side as usize);
        let image = Grey::new(&self.now.pixels, width, height, width);
        let image = image.ok_or_else(|| SourceError::value(&self.now.name, "no pixels", "some"))?;
        Ok(Some(Frame {
            sequence: self.sequence,
            data_ns: now_ns,
            exposure_ns: 0,
            published_ns: None,
            image,
        }))
    }
}

fn is_named(path: &Path, ends: &[&str]) -> bool {
    let end = path.extension().unwrap_or_default();
    ends.iter().any(|known| end.eq_ignore_ascii_case(known))
}

/// The pictures of a folder, the last one first.
fn listed(folder: &Path) -> Result<Vec<PathBuf>, SourceError> {
    let system = |error| SourceError::system(folder.display(), error);
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(system)? {
        let path = entry.map_err(system)?.path();
        if is_named(&path, &["png", "pgm"]) {
            files.push(path);
        }
    }
    files.sort_unstable_by(|a, b| b.cmp(a));
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pgm(folder: &Path, name: &str, level: u8) {
        let file = [b"P5\n2 1\n255\n".as_slice(), &[level, level + 1]].concat();
        std::fs::write(folder.join(name), file).unwrap();
    }

    fn all(source: &mut Replay) -> Vec<(u64, u64, Vec<u8>)> {
        let stop = AtomicBool::new(false);
        std::iter::from_fn(|| {
            let frame = source.next(&stop).unwrap()?;
            Some((frame.sequence, frame.data_ns, frame.image.row(0).to_vec()))
        })
        .collect()
    }

    #[test]
    fn pictures_come_in_the_order_of_their_names_with_stamps_of_now() {
        let folder = tempfile::tempdir().unwrap();
        for (name, level) in [
            ("b.pgm", 20),
            ("a02.PGM", 12),
            ("a10.pgm", 14),
            ("a.txt", 0),
        ] {
            pgm(folder.path(), name, level);
        }
        let before_ns = ipc::now_ns();
        let mut source = Replay::open(folder.path(), Some(100.0)).unwrap();
        assert_eq!(source.size(), [2, 1]);
        let frames = all(&mut source);
        let rows: Vec<_> = frames
            .iter()
            .map(|(n, _, row)| (*n, row[0], row[1]))
            .collect();
        assert_eq!(rows, [(1, 12, 13), (2, 14, 15), (3, 20, 21)]);
        let stamps: Vec<u64> = frames.iter().map(|(_, at, _)| *at).collect();
        assert!(stamps[0] >= before_ns && stamps[2] <= ipc::now_ns());
        for pair in stamps.windows(2) {
            // Never early; how late is up to the machine.
            assert!(pair[1] - pair[0] >= 5_000_000, "{stamps:?}");
        }
    }

    #[test]
    fn a_stop_ends_the_wait() {
        let folder = tempfile::tempdir().unwrap();
        (0..2).for_each(|k| pgm(folder.path(), &format!("{k}.pgm"), k));
        let mut source = Replay::open(folder.path(), Some(0.001)).unwrap();
        let stop = AtomicBool::new(false);
        assert!(source.next(&stop).unwrap().is_some());
        stop.store(true, Ordering::Relaxed);
        assert!(source.next(&stop).unwrap().is_none());
    }

    #[test]
    fn what_is_no_recording_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let error = |path: &Path, rate| Replay::open(path, rate).unwrap_err().to_string();
        let empty = error(folder.path(), None);
        assert!(
            empty.contains("no images; allowed: at least one"),
            "{empty}"
        );
        let none = error(&folder.path().join("none.mp4"), None);
        assert!(
            none.contains("none.mp4: not a recording; allowed: a folder"),
            "{none}"
        );
        for rate in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(error(folder.path(), Some(rate)).contains("allowed: 0.001 to 10000 Hz"));
        }
        pgm(folder.path(), "a.pgm", 1);
        std::fs::write(folder.path().join("b.pgm"), b"P5 1 1 255 \0").unwrap();
        let mut source = Replay::open(folder.path(), None).unwrap();
        let stop = AtomicBool::new(false);
        assert!(source.next(&stop).unwrap().is_some());
        let other = source.next(&stop).unwrap_err().to_string();
        assert!(
            other.ends_with("b.pgm: an image of 1x1 px; allowed: 2x1 px, as the first one"),
            "{other}"
        );
    }
}
