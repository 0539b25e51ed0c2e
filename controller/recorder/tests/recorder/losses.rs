//! What is missing or would be lost is counted, told, or refused.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use messages::{Features, Stamp};
use recorder::{Account, Notice, Options, record};
use recording::Recording;

use testkit::Place;

use crate::fixture::{FILE, Stage, options, recorded};

#[test]
fn lost_messages_restarts_and_refusals_are_counted_and_told() {
    let place = Place::new();
    let mut stage = Stage::open(&place.domain());
    let (ledger, notices) = recorded(&options(&place), || {
        stage.wait_for_recorder();
        let square = Features::new(&[[1.0, 2.0]; 4], 1);
        stage.camera.features.publish(&square).unwrap();
        (0..3).for_each(|_| stage.camera.features.skip());
        stage.camera.features.publish(&square).unwrap();
        // As from a camera that was started again.
        let mut again = square;
        again.stamp = Stamp {
            sequence: 1,
            published_ns: ipc::now_ns(),
            data_ns: 5,
        };
        stage.camera.features.publish_verbatim(&again).unwrap();
        let mut nan = again;
        nan.stamp.sequence = 2;
        nan.points[3] = f64::NAN;
        stage.camera.features.publish_verbatim(&nan).unwrap();
    });
    let account = Account {
        recorded: 3,
        lost: 3,
        refused: 1,
        restarts: 1,
    };
    assert_eq!(ledger.of("/vpc/features"), account);
    let told: Vec<_> = notices.iter().map(Notice::to_string).collect();
    assert_eq!(
        told,
        [
            "/vpc/features: 3 messages lost",
            "/vpc/features: the publisher started again",
            "/vpc/features: a message was refused: vpc/features: points[3] = NaN; allowed: finite numbers",
        ]
    );
    let recording = Recording::read(&place.path(FILE)).unwrap();
    assert_eq!(recording.metadata["vpc.ledger"], ledger.to_map());
    assert_eq!(Recording::missing(&recording.features), 3);
}

#[test]
fn a_file_is_not_overwritten_unless_asked() {
    let place = Place::new();
    let options = Options {
        duration: Some(Duration::ZERO),
        scene: None,
        ..options(&place)
    };
    let stop = AtomicBool::new(false);
    std::fs::write(place.path(FILE), "dear to somebody").unwrap();
    let refused = record(&options, &stop, |_| ()).unwrap_err();
    let message = format!(
        "{}: exists; allowed: a new file, or --force",
        place.path(FILE).display()
    );
    assert_eq!(refused.to_string(), message);
    assert_eq!(
        std::fs::read(place.path(FILE)).unwrap(),
        b"dear to somebody"
    );
    // Nobody was disturbed: not even the domain was made.
    assert!(!place.domain().exists());

    let options = Options {
        force: true,
        ..options
    };
    record(&options, &stop, |_| ()).unwrap();
    let recording = Recording::read(&place.path(FILE)).unwrap();
    assert!(
        recording.cut.is_none()
            && recording.features.is_empty()
            && recording.scene().unwrap().is_none()
    );
}
