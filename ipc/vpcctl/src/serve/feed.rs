//! What the page is told: the stage once, then an event for each look.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

use ipc::{CycleRecord, Hold, TwistState};
use serde_json::{Value, json};

use crate::phase::{Phase, Times};
use crate::request::strategy_name;
use crate::stage::Stage;
use crate::view::View;
use crate::words::faults;

/// Most cycles told in one event; of more, as in lockstep, only some are.
const CYCLES: usize = 50;
/// Events kept for pages that are slower than we are.
const KEPT: usize = 8;
/// Rows into which shapes are cut.
const ROWS: u32 = 240;
/// What the percentiles look back on, ns.
const WINDOW_NS: u64 = 10_000_000_000;

/// Size, goal, occlusions and limits. Occlusions are rectangles [u, v, width, height], px.
pub fn stage(stage: &Stage, view: &View) -> Value {
    let size = stage.size(view);
    let step = size[1] / f64::from(ROWS);
    let mut areas: Vec<[f64; 4]> = stage.painted().collect();
    if !stage.is_bare() {
        for row in 0..ROWS {
            let v = (f64::from(row) + 0.5) * step;
            let columns = (size[0] / step) as u32;
            let mut from = None;
            for column in 0..=columns {
                let u = (f64::from(column) + 0.5) * step;
                match (from, column < columns && stage.covers([u, v])) {
                    (None, true) => from = Some(u),
                    (Some(begin), false) => {
                        areas.push([begin - step / 2.0, v - step / 2.0, u - begin, step]);
                        from = None;
                    }
                    _ => (),
                }
            }
        }
    }
    json!({
        "size": size,
        "goal": stage.goal(),
        "areas": areas,
        "limits": stage.limits(view),
        "convergence_px": stage.convergence_px(),
    })
}

/// Tells what is new since the last event.
#[derive(Debug, Default)]
pub struct Teller {
    told: u64,
}

impl Teller {
    /// One event. Cycles are arrays: time in s, error px, clearance px, cycle us, wake us, the six of the twist.
    pub fn event(&mut self, view: &View, process: Option<u32>, now_ns: u64) -> Value {
        let newest = view.latest().map_or(0, |last| last.stamp.sequence);
        if newest < self.told {
            // The daemon started again.
            self.told = 0;
        }
        let news: Vec<&CycleRecord> = view
            .recent(u64::MAX)
            .filter(|record| record.stamp.sequence > self.told)
            .collect();
        self.told = newest;
        let step = news.len().div_ceil(CYCLES).max(1);
        let cycles: Vec<Value> = news.into_iter().rev().step_by(step).map(cycle).collect();
        let changes = view.changes().rev().take(8).map(|change| {
            let ago = now_ns.saturating_sub(change.at_ns) as f64 / 1e9;
            let cause = (change.hold != Hold::None).then(|| change.hold.to_string());
            json!([ago, change.state.to_string(), cause])
        });
        let robot = view.robot_at(now_ns).map(|robot| {
            let mode = robot.mode().map(|mode| mode.to_string());
            json!({ "mode": mode, "faults": faults(robot.faults()) })
        });
        json!({
            "process": process,
            "now_s": now_ns as f64 / 1e9,
            "silence_s": view.silence_ns(now_ns).map(|silence| silence as f64 / 1e9),
            "rate_hz": view.rate_hz(),
            "last": view.latest().map(|last| present(last, view)),
            "cycles": cycles.into_iter().rev().collect::<Vec<_>>(),
            "changes": changes.collect::<Vec<_>>(),
            "robot": robot,
        })
    }
}

fn present(last: &CycleRecord, view: &View) -> Value {
    let times = Times::of(view.recent(WINDOW_NS).map(|record| Phase::Cycle.of(record)));
    json!({
        "state": TwistState::from_code(last.state).map(|state| state.to_string()),
        "cause": last.hold().filter(|&hold| hold != Hold::None).map(|hold| hold.to_string()),
        "strategy": strategy_name(last.strategy, last.neighbours),
        "np": last.np,
        "cycle": last.cycle,
        "overruns": last.overruns,
        "lost": last.lost_records,
        "missed": view.missed,
        "p50_us": times.p50_ns as f64 / 1e3,
        "p99_us": times.p99_ns as f64 / 1e3,
        "error_px": last.error_px,
        "clearance_px": last.clearance_px,
        "points": last.pairs().collect::<Vec<_>>(),
        "way_point": last.way_point_pairs().collect::<Vec<_>>(),
    })
}

fn cycle(record: &CycleRecord) -> Value {
    let us = |phase: Phase| phase.of(record) as f64 / 1e3;
    let time = record.stamp.data_ns as f64 / 1e9;
    let [vx, vy, vz, wx, wy, wz] = record.twist;
    json!([
        time,
        record.error_px,
        record.clearance_px,
        us(Phase::Cycle),
        us(Phase::Wake),
        vx,
        vy,
        vz,
        wx,
        wy,
        wz
    ])
}

/// Events for any number of pages; who is slow skips some.
#[derive(Debug, Default)]
pub struct Feed {
    events: Mutex<Events>,
    news: Condvar,
}

#[derive(Debug, Default)]
struct Events {
    /// Number of the first one kept.
    first: u64,
    kept: VecDeque<Arc<str>>,
}

impl Feed {
    /// Adds an event.
    pub fn tell(&self, event: &Value) {
        let text: Arc<str> = format!("data: {event}\n\n").into();
        let mut events = self.events.lock().unwrap_or_else(PoisonError::into_inner);
        if events.kept.len() == KEPT {
            events.kept.pop_front();
            events.first += 1;
        }
        events.kept.push_back(text);
        drop(events);
        self.news.notify_all();
    }

    /// The event with this number or the first one kept, whichever is later, and the number of its successor; `None`
    /// where none came for a second.
    pub fn next(&self, number: u64) -> Option<(Arc<str>, u64)> {
        let events = self.events.lock().unwrap_or_else(PoisonError::into_inner);
        let none = |events: &mut Events| number >= events.first + events.kept.len() as u64;
        let (events, _) = self
            .news
            .wait_timeout_while(events, Duration::from_secs(1), none)
            .unwrap_or_else(PoisonError::into_inner);
        let number = number.max(events.first);
        let place = usize::try_from(number - events.first).ok()?;
        Some((Arc::clone(events.kept.get(place)?), number + 1))
    }

    /// The number that the next event will have.
    pub fn end(&self) -> u64 {
        let events = self.events.lock().unwrap_or_else(PoisonError::into_inner);
        events.first + events.kept.len() as u64
    }
}

#[cfg(test)]
mod tests {
    use ipc::{Order, Received};
    use scene::Scene;

    use super::*;
    use crate::view::tests::record;

    /// The rectangles of a stage that was told.
    fn areas(told: &Value) -> Vec<[f64; 4]> {
        serde_json::from_value(told["areas"].clone()).unwrap()
    }

    #[test]
    fn a_mask_is_told_pixel_by_pixel() {
        let painted = crate::stage::tests::painted(|i, j| i.abs_diff(500) + j.abs_diff(300) < 40);
        let told = stage(&painted, &View::default());
        let mut times = vec![0; 1024 * 1024];
        for [u, v, width, height] in areas(&told) {
            let (first, top) = ((u + 0.5) as usize, (v + 0.5) as usize);
            for row in top..top + height as usize {
                let begin = row * 1024 + first;
                times[begin..][..width as usize]
                    .iter_mut()
                    .for_each(|times| *times += 1);
            }
        }
        for (n, times) in times.into_iter().enumerate() {
            let inside = (n % 1024).abs_diff(500) + (n / 1024).abs_diff(300) < 40;
            assert_eq!(times, i32::from(inside), "pixel {n}");
        }
    }

    #[test]
    fn occlusions_are_cut_into_rows_that_cover_their_area() {
        let paper = Scene::parse(scene::PAPER_SIM, "paper-sim.toml").unwrap();
        let stage_of_paper = Stage::new(paper);
        let told = stage(&stage_of_paper, &View::default());
        let told_area: f64 = areas(&told).iter().map(|[_, _, w, h]| w * h).sum();
        let size = stage_of_paper.size(&View::default());
        let covered = (0..size[0] as u32)
            .flat_map(|u| (0..size[1] as u32).map(move |v| [f64::from(u), f64::from(v)]))
            .filter(|&point| stage_of_paper.covers(point))
            .count() as f64;
        assert!(
            (told_area / covered - 1.0).abs() < 0.02,
            "{told_area} px^2 of {covered}"
        );
    }

    #[test]
    fn every_cycle_is_told_once_and_a_restart_begins_again() {
        let mut view = View::default();
        let mut teller = Teller::default();
        let feed = |view: &mut View, number, order| {
            let message = record(number, TwistState::Moving, Hold::None);
            view.cycle(&Received { message, order });
        };
        let told = |event: Value| event["cycles"].as_array().unwrap().len();
        (1..=3).for_each(|number| feed(&mut view, number, Order::Next));
        assert_eq!(told(teller.event(&view, None, 0)), 3);
        assert_eq!(told(teller.event(&view, None, 0)), 0);
        feed(&mut view, 1, Order::Restarted);
        assert_eq!(told(teller.event(&view, None, 0)), 1);
        (2..=1000).for_each(|number| feed(&mut view, number, Order::Next));
        assert!(told(teller.event(&view, None, 0)) <= CYCLES);
    }

    #[test]
    fn a_slow_page_skips_to_what_is_kept() {
        let feed = Feed::default();
        for number in 0..20 {
            feed.tell(&json!(number));
        }
        let (text, next) = feed.next(3).unwrap();
        assert_eq!((&*text, next), ("data: 12\n\n", 13));
        assert_eq!(feed.end(), 20);
    }
}
