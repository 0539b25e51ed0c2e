//! Uncompressed video: YUV4MPEG2, of whose planes the luma is taken.

use std::fs::File;
use std::io::{BufRead, BufReader, ErrorKind, Read};
use std::path::Path;

use super::super::SourceError;
use super::picture::{MOST_SIDE, Picture, check_size};

/// Longest header of a file or a frame, bytes.
const MOST_HEADER: u64 = 4096;

/// A video file.
pub(super) struct Video {
    name: String,
    file: BufReader<File>,
    size: [u32; 2],
    /// Bytes of a frame after its luma.
    chroma: usize,
}

impl Video {
    /// Opens a file and reads its header.
    pub fn open(path: &Path) -> Result<Self, SourceError> {
        let name = path.display().to_string();
        let file =
            toml_schema::open_file(path).map_err(|error| SourceError::system(&name, error))?;
        let mut video = Self {
            name,
            file: BufReader::new(file),
            size: [0; 2],
            chroma: 0,
        };
        let header = video.line()?.unwrap_or_default();
        let mut words = header.split(' ');
        if words.next() != Some("YUV4MPEG2") {
            let allowed = "YUV4MPEG2; ffmpeg -i FILE -pix_fmt gray OUT.y4m makes one";
            return Err(video.refuse("no header of a Y4M file", allowed));
        }
        let mut format = "420jpeg";
        for word in words {
            let Some((key, value)) = word.split_at_checked(1) else {
                continue;
            };
            match key {
                "W" => video.size[0] = video.side(word, value)?,
                "H" => video.size[1] = video.side(word, value)?,
                "C" => format = value,
                _ => (),
            }
        }
        check_size(&video.name, video.size)?;
        let [width, height] = video.size.map(|side| side as usize);
        video.chroma = 2 * match format {
            "mono" => 0,
            "420" | "420jpeg" | "420mpeg2" | "420paldv" => width.div_ceil(2) * height.div_ceil(2),
            "422" => width.div_ceil(2) * height,
            "444" => width * height,
            _ => {
                let found = format!("the format {format}");
                return Err(video.refuse(&found, "mono, 420, 422 or 444, of 8 bits"));
            }
        };
        Ok(video)
    }

    /// The next frame.
    pub fn next(&mut self) -> Result<Option<Picture>, SourceError> {
        let Some(header) = self.line()? else {
            return Ok(None);
        };
        if header.split(' ').next() != Some("FRAME") {
            return Err(self.refuse("no header of a frame", "FRAME"));
        }
        let [width, height] = self.size.map(|side| side as usize);
        let mut pixels = vec![0; width * height + self.chroma];
        self.file
            .read_exact(&mut pixels)
            .map_err(|error| match error.kind() {
                ErrorKind::UnexpectedEof => {
                    self.refuse("the last frame is cut off", "whole frames")
                }
                _ => SourceError::system(&self.name, error),
            })?;
        pixels.truncate(width * height);
        Ok(Some(Picture {
            name: self.name.clone(),
            size: self.size,
            pixels,
        }))
    }

    /// A header without its end; `None` at the end of the file.
    fn line(&mut self) -> Result<Option<String>, SourceError> {
        let mut line = Vec::new();
        let mut header = self.file.by_ref().take(MOST_HEADER);
        let read = header.read_until(b'\n', &mut line);
        read.map_err(|error| SourceError::system(&self.name, error))?;
        let text = String::from_utf8_lossy(&line);
        Ok((!line.is_empty()).then(|| text.trim_end().to_owned()))
    }

    /// Width or height, px; `word` is the header's.
    fn side(&self, word: &str, value: &str) -> Result<u32, SourceError> {
        let allowed = format!("1 to {MOST_SIDE} px");
        value.parse().map_err(|_| self.refuse(word, &allowed))
    }

    fn refuse(&self, found: &str, allowed: &str) -> SourceError {
        SourceError::value(&self.name, found, allowed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(bytes: &[u8]) -> Result<Vec<Vec<u8>>, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.y4m");
        std::fs::write(&path, bytes).unwrap();
        let words = |error: SourceError| error.to_string();
        let mut video = Video::open(&path).map_err(words)?;
        let mut frames = Vec::new();
        while let Some(frame) = video.next().map_err(words)? {
            assert_eq!(frame.size, [3, 1]);
            frames.push(frame.pixels);
        }
        Ok(frames)
    }

    #[test]
    fn luma_is_taken_of_every_format() {
        for (format, chroma) in [
            ("Cmono", 0),
            ("", 4),
            (" C420jpeg", 4),
            ("C422", 4),
            ("C444", 6),
        ] {
            let mut file =
                format!("YUV4MPEG2 W3 H1 F30:1 Ip {format} XCOLORRANGE=FULL\n").into_bytes();
            for level in [1, 2] {
                file.extend(b"FRAME Xa\n");
                file.extend([level; 3]);
                file.extend(vec![128; chroma]);
            }
            assert_eq!(frames(&file).unwrap(), [[1; 3], [2; 3]], "{format}");
        }
    }

    #[test]
    fn what_is_no_video_is_refused_by_name() {
        for (file, said) in [
            ("", "a.y4m: no header of a Y4M file; allowed: YUV4MPEG2"),
            ("RIFF", "no header of a Y4M file"),
            (
                "YUV4MPEG2 W3 H1 C420p10\n",
                "the format 420p10; allowed: mono, 420, 422 or 444, of 8 bits",
            ),
            ("YUV4MPEG2 H1\n", "an image of 0x1 px"),
            ("YUV4MPEG2 Wx H1\n", "a.y4m: Wx; allowed: 1 to 8192 px"),
            (
                "YUV4MPEG2 W18446744073709551616 H1\n",
                "W18446744073709551616; allowed: 1 to 8192 px",
            ),
            (
                "YUV4MPEG2 W3 H1 Cmono\nFRAME\nab",
                "the last frame is cut off",
            ),
            ("YUV4MPEG2 W3 H1 Cmono\nFRAMES\nabc", "no header of a frame"),
        ] {
            let error = frames(file.as_bytes()).unwrap_err();
            assert!(error.contains(said), "{error}");
        }
    }
}
