//! The live picture: the camera's newest image, made small enough for a page.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use axum::body::Bytes;
use axum::http::header::{CONTENT_TYPE, ETAG, IF_NONE_MATCH};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use ipc::Image;
use messages::ImageHeader;

use crate::server::field;

/// Most bytes of a picture; of larger images, every n-th pixel of every n-th row is shown.
const MOST: usize = 1 << 20;
/// Least time between two pictures, however many pages ask.
const PAUSE: Duration = Duration::from_millis(100);
/// How long after a request pictures are made.
const INTEREST: Duration = Duration::from_secs(1);
/// The head that describes the body: width and height of the image, columns and rows of the picture,
/// encoding. The page decodes it: that costs the server nothing.
const SHAPE: HeaderName = HeaderName::from_static("x-vpc-picture");

/// A picture as it is sent.
#[derive(Clone, Debug)]
struct Picture {
    shape: HeaderValue,
    tag: HeaderValue,
    bytes: Bytes,
}

/// The newest picture, and whether somebody wants to see it. The server's loop makes pictures; the
/// handlers only pass them on.
#[derive(Debug, Default)]
pub struct Pictures(Mutex<State>);

#[derive(Debug, Default)]
struct State {
    asked: Option<Instant>,
    made: Option<Instant>,
    newest: Option<Picture>,
}

impl Pictures {
    /// Takes in the newest image, if a page asked lately and has not got it.
    pub fn show(&self, image: &Image, now: Instant) {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let since = |at: Instant| now.saturating_duration_since(at);
        let within = |at: Option<Instant>, span| at.is_some_and(|at| since(at) < span);
        if !within(state.asked, INTEREST) || within(state.made, PAUSE) {
            return;
        }
        let tag = tag(image.header());
        if state.newest.as_ref().is_none_or(|shown| shown.tag != tag) {
            state.newest = picture(image, tag);
            state.made = Some(now);
        }
    }

    /// The answer to a page: 200 with the picture, 304 if it has that one, 204 if there is none.
    pub fn answer(&self, headers: &HeaderMap, now: Instant) -> Response {
        let newest = {
            let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            state.asked = Some(now);
            state.newest.clone()
        };
        let Some(Picture { shape, tag, bytes }) = newest else {
            return StatusCode::NO_CONTENT.into_response();
        };
        if field(headers, IF_NONE_MATCH).is_some_and(|known| known == tag) {
            return StatusCode::NOT_MODIFIED.into_response();
        }
        let media = HeaderValue::from_static("application/octet-stream");
        let head = [(CONTENT_TYPE, media), (SHAPE, shape), (ETAG, tag)];
        (head, bytes).into_response()
    }
}

/// Tells an image from those before it, also of another camera.
fn tag(header: &ImageHeader) -> HeaderValue {
    let stamp = header.stamp;
    let words = format!("\"{}-{}\"", stamp.sequence, stamp.published_ns);
    HeaderValue::try_from(words).unwrap_or(HeaderValue::from_static("\"\""))
}

/// The image as a picture; `None` if its encoding is unknown.
fn picture(image: &Image, tag: HeaderValue) -> Option<Picture> {
    let ImageHeader { width, height, .. } = *image.header();
    let encoding = image.header().encoding()?;
    let pixel = encoding.bytes_per_pixel();
    let size = |step| [width, height].map(|side| (side as usize).div_ceil(step));
    let steps = 1..=width.max(height) as usize;
    let mut steps = steps.filter(|&step| size(step).iter().product::<usize>() * pixel <= MOST);
    let step = steps.next()?;
    let [columns, rows] = size(step);
    let mut bytes = Vec::with_capacity(columns * rows * pixel);
    for row in image.rows().step_by(step) {
        match step {
            1 => bytes.extend_from_slice(row),
            _ => {
                let pixels = row.chunks_exact(pixel).step_by(step);
                pixels.for_each(|pixel| bytes.extend_from_slice(pixel));
            }
        }
    }
    let shape = format!("{width} {height} {columns} {rows} {encoding}");
    Some(Picture {
        shape: HeaderValue::try_from(shape).ok()?,
        tag,
        bytes: bytes.into(),
    })
}

#[cfg(test)]
mod tests {
    use messages::Encoding;

    use super::*;

    /// The picture of an image whose bytes count up: its shape and its bytes.
    fn shown(width: u32, height: u32, encoding: Encoding) -> (String, Vec<u8>) {
        let directory = tempfile::tempdir().unwrap();
        let domain = ipc::Domain::join(directory.path()).unwrap();
        let mut header = ImageHeader::new(width, height, encoding, 7);
        header.stride += 1;
        let mut publisher = domain.image_publisher(header.bytes().unwrap()).unwrap();
        let mut subscriber = domain.image_subscriber().unwrap();
        let mut image = publisher.loan(&header).unwrap();
        let bytes = image.iter_mut().enumerate();
        bytes.for_each(|(k, byte)| *byte = k as u8);
        publisher.publish(image).unwrap();
        let image = subscriber.latest().unwrap().unwrap();
        let Picture { shape, bytes, .. } = picture(&image, tag(image.header())).unwrap();
        (shape.to_str().unwrap().to_owned(), bytes.to_vec())
    }

    #[test]
    fn a_small_image_is_shown_as_it_is() {
        let (shape, bytes) = shown(3, 2, Encoding::Mono8);
        assert_eq!(shape, "3 2 3 2 mono8");
        assert_eq!(bytes, [0, 1, 2, 4, 5, 6]);
        let (shape, bytes) = shown(2, 2, Encoding::Bgr8);
        assert_eq!(shape, "2 2 2 2 bgr8");
        assert_eq!(bytes, [0, 1, 2, 3, 4, 5, 7, 8, 9, 10, 11, 12]);
    }

    #[test]
    fn a_large_image_is_thinned_out() {
        for (encoding, step) in [
            (Encoding::Mono8, 2),
            (Encoding::Yuyv, 2),
            (Encoding::Rgb8, 3),
        ] {
            let (width, height, pixel) = (2047, 1023, encoding.bytes_per_pixel());
            let (shape, bytes) = shown(width, height, encoding);
            let [columns, rows] = [width, height].map(|side| (side as usize).div_ceil(step));
            assert_eq!(
                shape,
                format!("{width} {height} {columns} {rows} {encoding}")
            );
            assert_eq!(bytes.len(), columns * rows * pixel);
            assert!(bytes.len() <= MOST);
            // Column 5 of row 7.
            let place = (7 * columns + 5) * pixel;
            let from = 7 * step * (2047 * pixel + 1) + 5 * step * pixel;
            let expected = (from..from + pixel).map(|byte| byte as u8);
            assert!(
                bytes[place..place + pixel].iter().copied().eq(expected),
                "{encoding}"
            );
        }
    }

    #[test]
    fn pictures_are_made_only_when_somebody_asks_and_not_too_often() {
        let directory = tempfile::tempdir().unwrap();
        let domain = ipc::Domain::join(directory.path()).unwrap();
        let mut publisher = domain.image_publisher(4).unwrap();
        let mut subscriber = domain.image_subscriber().unwrap();
        let mut next = || {
            let image = publisher.loan(&ImageHeader::new(2, 2, Encoding::Mono8, 0));
            publisher.publish(image.unwrap()).unwrap();
            subscriber.latest().unwrap().unwrap()
        };
        let (pictures, mut headers) = (Pictures::default(), HeaderMap::new());
        let begin = Instant::now();
        let answer = |headers: &HeaderMap, at| pictures.answer(headers, begin + at);
        let status = |headers: &HeaderMap, at| answer(headers, at).status();
        pictures.show(&next(), begin);
        assert_eq!(status(&headers, Duration::ZERO), StatusCode::NO_CONTENT);
        pictures.show(&next(), begin);
        let first = answer(&headers, Duration::ZERO);
        assert_eq!(first.status(), StatusCode::OK);
        headers.insert(IF_NONE_MATCH, first.headers()[ETAG].clone());
        assert_eq!(status(&headers, Duration::ZERO), StatusCode::NOT_MODIFIED);
        // Too early, then late enough.
        let image = next();
        let early = PAUSE - Duration::from_millis(1);
        pictures.show(&image, begin + early);
        assert_eq!(status(&headers, early), StatusCode::NOT_MODIFIED);
        pictures.show(&image, begin + PAUSE);
        assert_eq!(status(&headers, PAUSE), StatusCode::OK);
        // Nobody has asked for a second.
        let late = PAUSE + INTEREST;
        pictures.show(&next(), begin + late);
        let last = answer(&headers, late);
        assert_eq!(last.headers()[ETAG], tag(image.header()));
    }
}
