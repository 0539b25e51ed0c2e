//! Images: the same memory at both ends, and what goes wrong.

use std::os::unix::fs::MetadataExt;
use std::time::Duration;

use ipc::{
    Domain, ImagePorts, ImagePublisher, ImageSubscriber, LoanError, OpenError, ReceiveError,
};
use messages::{Encoding, ImageHeader, Order};
use testkit::{Place, eventually};

use crate::peers::working;
use crate::{STEADY_KILLS, prefix};

/// Bytes of a grey image of this size.
const BYTES: usize = 640 * 480;
/// Images of the allocation test.
const IMAGES: u64 = 1_000;

fn header() -> ImageHeader {
    ImageHeader::new(640, 480, Encoding::Mono8, ipc::now_ns())
}

fn ports(domain: &Domain) -> (ImagePublisher, ImageSubscriber) {
    let publisher = domain.image_publisher(BYTES).unwrap();
    (publisher, domain.image_subscriber().unwrap())
}

/// Sends an image all of whose pixels are `grey`.
fn send_one(publisher: &mut ImagePublisher, grey: u8) -> ipc::Sent {
    let mut image = publisher.loan(&header()).unwrap();
    image.fill(grey);
    publisher.publish(image).unwrap()
}

/// The file that is mapped where these bytes are, and where in it they begin.
fn place_in_file(bytes: &[u8]) -> (String, usize) {
    let at = bytes.as_ptr() as usize;
    let maps = std::fs::read_to_string("/proc/self/maps").unwrap();
    let hexadecimal = |word: &str| usize::from_str_radix(word, 16).unwrap();
    let found = maps.lines().find_map(|line| {
        // 7f0000000000-7f0000001000 rw-s 00000000 00:1a 123 /dev/shm/vpc_...
        let words: Vec<_> = line.split_whitespace().collect();
        let (begin, end) = words[0].split_once('-').unwrap();
        let (begin, end) = (hexadecimal(begin), hexadecimal(end));
        let file = words.get(5).copied().unwrap_or_default();
        (begin..end)
            .contains(&at)
            .then(|| (file.to_owned(), hexadecimal(words[2]) + at - begin))
    });
    found.unwrap()
}

#[test]
fn an_image_is_the_same_memory_at_both_ends() {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let (mut publisher, mut subscriber) = ports(&domain);
    assert!(subscriber.latest().unwrap().is_none());
    let mut sent_header = header();
    sent_header.exposure_ns = 4_000_000;
    let mut image = publisher.loan(&sent_header).unwrap();
    assert_eq!((image.len(), image.as_ptr().addr() % 64), (BYTES, 0));
    for (k, pixel) in image.iter_mut().enumerate() {
        *pixel = (k % 251) as u8;
    }
    let begin = image.header().stamp.data_ns - 2_000_000;
    image.header_mut().exposure_begin_ns = begin;
    let written = place_in_file(&image);
    let sent = publisher.publish(image).unwrap();
    assert_eq!((sent.sequence, sent.receivers), (1, 1));

    let received = subscriber.latest().unwrap().unwrap();
    assert_eq!(received.order(), Order::First);
    sent_header.stamp.sequence = 1;
    sent_header.stamp.published_ns = sent.published_ns;
    sent_header.exposure_begin_ns = begin;
    assert_eq!(*received.header(), sent_header);
    assert!(
        received
            .iter()
            .enumerate()
            .all(|(k, pixel)| *pixel == (k % 251) as u8)
    );
    assert_eq!(place_in_file(&received), written);
    let memory = format!("/dev/shm/{}", prefix(&place.domain()));
    assert!(written.0.starts_with(&memory), "{written:?}");
    assert!(subscriber.latest().unwrap().is_none());
}

#[test]
fn rows_leave_out_what_follows_them() {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let (mut publisher, mut subscriber) = ports(&domain);
    let mut header = ImageHeader::new(3, 2, Encoding::Rgb8, ipc::now_ns());
    header.stride = 16;
    let mut image = publisher.loan(&header).unwrap();
    let numbers: Vec<u8> = (0..32).collect();
    image.copy_from_slice(&numbers);
    publisher.publish(image).unwrap();
    let image = subscriber.latest().unwrap().unwrap();
    assert!(image.rows().eq([&numbers[0..9], &numbers[16..25]]));
}

#[test]
fn wrong_images_are_refused_at_both_ends() {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    for most in [0, messages::MOST_IMAGE_BYTES + 1, usize::MAX] {
        let error = domain.image_publisher(most).unwrap_err().to_string();
        let words = format!("images of {most} bytes; allowed: 1 to 268435456");
        assert!(error.contains(&words), "{error}");
    }
    let (mut publisher, mut subscriber) = ports(&domain);
    let mut large = header();
    large.height += 1;
    let error = publisher.loan(&large).unwrap_err();
    assert!(matches!(error, LoanError::TooLarge { .. }));
    assert_eq!(
        error.to_string(),
        "vpc/image: an image of 307840 bytes; allowed: 307200, for which the port was opened"
    );
    let mut narrow = header();
    narrow.stride = 639;
    let error = publisher.loan(&narrow).unwrap_err();
    assert_eq!(
        error.to_string(),
        "vpc/image: stride = 639; allowed: 640 or more"
    );
    let loaned = publisher.loan(&header()).unwrap();
    let error = publisher.loan(&header()).unwrap_err();
    assert!(matches!(error, LoanError::Transport { .. }), "{error}");
    // One that is not sent goes back.
    drop(loaned);

    let mut refusal = |change: fn(&mut ImageHeader)| {
        let mut image = publisher.loan(&header()).unwrap();
        change(image.header_mut());
        publisher.publish(image).unwrap();
        let error = subscriber.latest().unwrap_err();
        assert!(matches!(error, ReceiveError::Invalid { .. }));
        error.to_string()
    };
    assert_eq!(
        refusal(|header| header.height = 479),
        "vpc/image: bytes = 307200; allowed: 306560"
    );
    assert_eq!(
        refusal(|header| header.encoding = 9),
        "vpc/image: encoding = 9; allowed: 0 mono8, 1 bgr8, 2 rgb8, 3 yuyv"
    );
    // The next good one is taken, and is no gap: refused images count as seen.
    send_one(&mut publisher, 1);
    let order = subscriber.latest().unwrap().unwrap().order();
    assert_eq!(order, Order::Next);
}

#[test]
fn a_slow_subscriber_gets_the_newest_and_counts_the_rest() {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let (mut publisher, mut subscriber) = ports(&domain);
    send_one(&mut publisher, 1);
    let held = subscriber.latest().unwrap().unwrap();
    for grey in 2..100 {
        send_one(&mut publisher, grey);
    }
    publisher.skip();
    send_one(&mut publisher, 100);
    let newest = subscriber.latest().unwrap().unwrap();
    assert_eq!(
        (newest[0], newest.order()),
        (100, Order::Gap { missed: 99 })
    );
    // Nobody wrote into what is borrowed.
    assert!(held.iter().all(|pixel| *pixel == 1));
    // Two are held: a third one is taken, but what comes after it cannot be.
    send_one(&mut publisher, 101);
    send_one(&mut publisher, 102);
    let error = subscriber.latest().unwrap_err();
    assert!(matches!(error, ReceiveError::Transport { .. }), "{error}");
    drop(held);
    assert_eq!(subscriber.latest().unwrap().unwrap()[0], 102);
}

#[test]
fn another_camera_takes_over_with_images_of_another_size() {
    let place = Place::new();
    let first = Domain::join(&place.domain()).unwrap();
    let second = Domain::join(&place.domain()).unwrap();
    let (mut publisher, mut subscriber) = ports(&first);
    let error = second.image_publisher(BYTES).unwrap_err();
    assert!(matches!(error, OpenError::Taken { .. }), "{error}");
    send_one(&mut publisher, 1);
    let held = subscriber.latest().unwrap().unwrap();
    drop(publisher);
    let mut publisher = second.image_publisher(4 * BYTES).unwrap();
    let large = ImageHeader::new(1280, 960, Encoding::Mono8, ipc::now_ns());
    let mut image = publisher.loan(&large).unwrap();
    image.fill(2);
    publisher.publish(image).unwrap();
    let image = subscriber.latest().unwrap().unwrap();
    assert_eq!((image.len(), image[0]), (4 * BYTES, 2));
    assert_eq!(image.order(), Order::Restarted);
    assert!(held.iter().all(|pixel| *pixel == 1));
}

#[test]
fn a_killed_camera_comes_back_and_its_last_image_stays() {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut subscriber = domain.image_subscriber().unwrap();
    let mut held: Option<ipc::Image> = None;
    for _ in 0..STEADY_KILLS {
        let camera = working("images", &place);
        let seen = eventually("an image", || subscriber.latest().unwrap());
        camera.kill();
        if let Some(held) = &held {
            assert!(held.iter().all(|pixel| *pixel == held[0]));
        }
        held = Some(seen);
        while subscriber.latest().unwrap().is_some() {}
    }
}

#[test]
fn in_lockstep_who_finds_the_features_may_come_late() {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let mut camera = ImagePorts::open(&domain, BYTES).unwrap();
    let sent = send_one(&mut camera.images, 1);
    assert_eq!(sent.receivers, 0);
    let patience = testkit::PATIENCE;
    assert_eq!(camera.wait_for_answer(&sent, Duration::ZERO).unwrap(), None);
    let echo = working("image-echo", &place);
    for k in 1..20 {
        let sent = if k == 1 {
            sent
        } else {
            send_one(&mut camera.images, 1)
        };
        let answer = camera.wait_for_answer(&sent, patience).unwrap().unwrap();
        assert_eq!(answer.features_sequence, k);
    }
    echo.kill();
}

#[test]
fn memory_is_taken_for_images_under_way_only() {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let taken = || {
        let files = std::fs::read_dir("/dev/shm").unwrap().map(Result::unwrap);
        let prefix = prefix(&place.domain());
        let ours = files.filter(|file| file.file_name().to_string_lossy().starts_with(&prefix));
        ours.map(|file| 512 * file.metadata().unwrap().blocks())
            .sum::<u64>()
    };
    let before = taken();
    let (mut publisher, mut subscriber) = ports(&domain);
    for grey in 0..100 {
        send_one(&mut publisher, grey);
        if grey % 3 == 0 {
            subscriber.latest().unwrap().unwrap();
        }
    }
    // Two wait, one is kept for who comes late, one is loaned.
    let images = (taken() - before) as f64 / BYTES as f64;
    assert!((1.0..6.0).contains(&images), "{images} images");
}

#[test]
fn sending_and_receiving_images_never_allocates() {
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    let (mut publisher, mut subscriber) = ports(&domain);
    let mut round = |k: u64| {
        let mut image = publisher.loan(&header()).unwrap();
        image[0] = k as u8;
        publisher.publish(image).unwrap();
        let image = subscriber.latest().unwrap().unwrap();
        assert_eq!(image[0], k as u8);
    };
    // Connections are made, and allocate, with the first image.
    (1..=8).for_each(&mut round);
    let before = heap_meter::calls();
    (9..=IMAGES).for_each(&mut round);
    assert_eq!(heap_meter::calls() - before, 0);
}
