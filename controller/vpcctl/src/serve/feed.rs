//! The events that a page receives.

use messages::CycleRecord;
use serde_json::{Value, json};

use crate::image_plane::ImagePlane;
use crate::joints::{Joint, joints};
use crate::latency::{CYCLE, WAKE, durations};
use crate::output::Tone;
use crate::status::Status;
use crate::view::View;

/// Most cycles in one event after the first; of more, as in lockstep, only every n-th is sent.
const CYCLES: usize = 50;
/// The scene is in the first event and in every n-th after it.
const SCENE: u64 = 100;
/// Most changes of state in an event.
const CHANGES: usize = 6;
/// Corners of the outline of an occlusion's part.
const CORNERS: usize = 128;

/// The events of one page. The first one has all that is known, each later one what is new.
#[derive(Debug)]
pub struct Feed {
    plane: ImagePlane,
    events: u64,
    /// Sequence number of the newest cycle that was sent.
    sent: u64,
}

impl Feed {
    /// A feed that has sent nothing yet.
    pub fn new(plane: ImagePlane) -> Self {
        Self {
            plane,
            events: 0,
            sent: 0,
        }
    }

    /// The next event.
    pub fn event(&mut self, status: &Status) -> Value {
        let (view, now_ns) = (&status.view, status.now_ns);
        let (headline, cause, tone) = status.headline();
        let changes = view.changes().rev().take(CHANGES).map(|change| {
            let age_s = now_ns.saturating_sub(change.at_ns) as f64 / 1e9;
            let cause = change.hold.map(|hold| hold.to_string());
            let tone = Tone::of(change.state, change.hold).name();
            json!([age_s, change.state.to_string(), cause, tone])
        });
        let seen = view.seen.map(|record| {
            json!({
                "age_s": now_ns.saturating_sub(record.stamp.data_ns) as f64 / 1e9,
                "error_px": record.error_px,
                "clearance_px": record.clearance_px,
                "points": record.pairs().collect::<Vec<_>>(),
                "hidden": record
                    .ellipses()
                    .map(|(point, outline)| json!([point, outline.collect::<Vec<_>>()]))
                    .collect::<Vec<_>>(),
                "way_point": record.way_point_pairs().collect::<Vec<_>>(),
                "foreseen": record.foreseen().map(Iterator::collect).collect::<Vec<Vec<_>>>(),
            })
        });
        let mut event = json!({
            "headline": headline,
            "cause": cause,
            "tone": tone.name(),
            "status": status.json(),
            "robot": view.robot_words(now_ns),
            "joints": joints(view, now_ns).iter().map(bar).collect::<Vec<_>>(),
            "now_s": now_ns as f64 / 1e9,
            "cycles": self.news(view),
            "changes": changes.collect::<Vec<_>>(),
            "seen": seen,
            "image": view.image().map(|image| {
                let age_ns = now_ns.saturating_sub(image.stamp.published_ns);
                json!([image.stamp.sequence, age_ns as f64 / 1e9])
            }),
        });
        if self.events.is_multiple_of(SCENE) {
            self.plane.refresh();
            event["scene"] = scene(&self.plane, view);
        }
        self.events += 1;
        event
    }

    /// The cycles since the last event, oldest first.
    fn news(&mut self, view: &View) -> Vec<Value> {
        let newest = view.latest().map_or(0, |last| last.stamp.sequence);
        if newest < self.sent {
            // The daemon started again.
            self.sent = 0;
        }
        let records = view.recent(u64::MAX);
        let news: Vec<_> = records.filter(|r| r.stamp.sequence > self.sent).collect();
        let every = match self.sent {
            0 => 1,
            _ => news.len().div_ceil(CYCLES).max(1),
        };
        self.sent = newest;
        let mut rows: Vec<_> = news.into_iter().rev().step_by(every).map(row).collect();
        rows.reverse();
        rows
    }
}

/// Time in s, error px, clearance px, cycle us, wake-up us, the six of the twist, the points px,
/// the number of their frame (where it falls, the camera began another run), and the six of the
/// pattern's own motion.
fn row(record: &CycleRecord) -> Value {
    let us = durations(record).map(|ns| ns as f64 / 1e3);
    let [vx, vy, vz, wx, wy, wz] = record.twist;
    let points: Vec<_> = record.pairs().collect();
    let time = record.stamp.data_ns as f64 / 1e9;
    let (error, clearance) = (record.error_px, record.clearance_px);
    let frame = record.features_sequence;
    let numbers = [
        time, error, clearance, us[CYCLE], us[WAKE], vx, vy, vz, wx, wy, wz,
    ];
    let numbers = numbers.into_iter().map(Value::from);
    let own = record.drift.into_iter().map(Value::from);
    let row = numbers.chain([json!(points), json!(frame)]).chain(own);
    row.collect()
}

/// Name, position with its unit, whether it binds, and places in the range from 0 to 1: of the
/// joint, and between which the law keeps it; null where it turns without end.
fn bar(joint: &Joint) -> Value {
    let [least, most] = joint.range;
    let places = [joint.q, least + joint.margin, most - joint.margin];
    let places = places.map(|q| joint.place(q));
    let position = format!("{:.2} {}", joint.q, joint.unit);
    json!([joint.name, position, joint.binds, places])
}

/// The image plane. Parts are the corners [u, v] of their outlines, painted pixels are rectangles
/// [u, v, width, height], all in px.
fn scene(plane: &ImagePlane, view: &View) -> Value {
    // A twentieth of a pixel is less than a screen shows.
    let rounded = |corner: [f64; 2]| corner.map(|x| (x * 10.0).round() / 10.0);
    let parts = plane
        .parts()
        .map(|part| part.outline(CORNERS).map(rounded).collect::<Vec<_>>());
    json!({
        "known": plane.has_scene(),
        "size": plane.size(view),
        "goal": plane.goal(),
        "parts": parts.collect::<Vec<_>>(),
        "painted": plane.painted().collect::<Vec<_>>(),
        "limits": plane.limits(view),
    })
}

#[cfg(test)]
mod tests {
    use messages::{Order, Received, TwistState};

    use messages::Hold;

    use super::*;
    use crate::image_plane::tests::{painted, paper};
    use crate::joints::tests::with_arm;
    use crate::view::tests::record;

    #[test]
    fn a_mask_is_told_pixel_by_pixel() {
        let inside = |i: usize, j: usize| i.abs_diff(500) + j.abs_diff(300) < 40;
        let plane = painted(|i, j| inside(i as usize, j as usize));
        let told = scene(&plane, &View::default());
        let rectangles: Vec<[f64; 4]> = serde_json::from_value(told["painted"].clone()).unwrap();
        let mut times = vec![0; 1024 * 1024];
        for [u, v, width, height] in rectangles {
            let (first, top) = ((u + 0.5) as usize, (v + 0.5) as usize);
            for row in top..top + height as usize {
                let begin = row * 1024 + first;
                times[begin..][..width as usize]
                    .iter_mut()
                    .for_each(|times| *times += 1);
            }
        }
        for (n, times) in times.into_iter().enumerate() {
            assert_eq!(times, i32::from(inside(n % 1024, n / 1024)), "pixel {n}");
        }
    }

    #[test]
    fn joints_are_told_with_their_places() {
        let mut status = Status::default();
        let message = record(1, TwistState::Moving, None);
        let order = Order::Next;
        status.view.cycle(&Received { message, order });
        status.view = with_arm(status.view, 0);
        let event = Feed::new(ImagePlane::default()).event(&status);
        let bar = &event["joints"][3];
        let [name, position, binds] = [0, 1, 2].map(|k| &bar[k]);
        assert_eq!(
            (name, position),
            (&json!("panda_joint4"), &json!("-2.87 rad"))
        );
        assert_eq!(binds, &json!(true));
        let places: Vec<f64> = serde_json::from_value(bar[3].clone()).unwrap();
        let expected = [0.2018 / 3.002, 0.2 / 3.002, 1.0 - 0.2 / 3.002];
        for (place, expected) in places.iter().zip(expected) {
            assert!((place - expected).abs() < 1e-9, "{places:?}");
        }
    }

    #[test]
    fn every_part_is_told_as_its_outline() {
        let plane = paper();
        let told = scene(&plane, &View::default());
        let parts: Vec<Vec<[f64; 2]>> = serde_json::from_value(told["parts"].clone()).unwrap();
        assert_eq!(parts.len(), plane.parts().count());
        for (told, part) in parts.iter().zip(plane.parts()) {
            assert_eq!(told.len(), CORNERS);
            // The first direction is that of u.
            let [u, v] = [part.bounds()[1][0], part.center[1]];
            assert!((told[0][0] - u).abs() <= 0.051 && (told[0][1] - v).abs() <= 0.051);
        }
    }

    #[test]
    fn every_cycle_is_told_once_and_a_restart_begins_again() {
        let mut status = Status::default();
        let mut feed = Feed::new(ImagePlane::default());
        let add = |status: &mut Status, number, order| {
            let message = record(number, TwistState::Moving, None);
            status.view.cycle(&Received { message, order });
        };
        let told = |event: Value| event["cycles"].as_array().unwrap().len();
        (1..=300).for_each(|number| add(&mut status, number, Order::Next));
        // What was before the page was opened: all.
        assert_eq!(told(feed.event(&status)), 300);
        assert_eq!(told(feed.event(&status)), 0);
        add(&mut status, 1, Order::Restarted);
        assert_eq!(told(feed.event(&status)), 1);
        (2..=1000).for_each(|number| add(&mut status, number, Order::Next));
        assert!(told(feed.event(&status)) <= CYCLES);
    }

    #[test]
    fn what_a_run_came_to_is_told_after_its_end() {
        let mut status = Status::default();
        let mut used = record(1, TwistState::Arrived, None);
        (used.count, used.error_px) = (4, 0.5);
        for message in [used, record(2, TwistState::Holding, Hold::Stale)] {
            let order = Order::Next;
            status.view.cycle(&Received { message, order });
        }
        status.now_ns = 20_000_000;
        let event = Feed::new(ImagePlane::default()).event(&status);
        assert_eq!(event["status"]["state"], "holding");
        assert_eq!(event["tone"], "warning");
        assert_eq!(event["seen"]["error_px"], 0.5);
        assert_eq!(event["seen"]["points"].as_array().unwrap().len(), 4);
    }
}
