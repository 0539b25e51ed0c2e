//! Nothing is allocated per frame: drawing, detecting and delivering take their memory when they
//! are made.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use scene::Scene;
use vision::{Detector, DetectorSettings, Latency, Look, Renderer, Sightings, Transit};

thread_local! {
    static COUNT: Cell<usize> = const { Cell::new(0) };
}

/// The system's allocator, which counts the allocations of each thread.
struct Counting;

// SAFETY: every call is passed on to `System` unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let _ = COUNT.try_with(|count| count.set(count.get() + 1));
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn a_frame_allocates_nothing() {
    let scene = Scene::parse(scene::PAPER_ROBOT, "paper-robot.toml").unwrap();
    let mut renderer = Renderer::new(&scene, &Look::default());
    let mut detector = Detector::new(&scene, &DetectorSettings::default());
    let mut transit: Transit<Sightings> = Transit::new(Latency {
        jitter_ns: 20_000_000,
        drop: 0.1,
        ..Latency::default()
    });
    // Down behind the object and out of the image, so that every path is taken: followed, hidden,
    // lost, found again.
    let mut frame = |k: u64| {
        let mut pose = scene.goal;
        pose.translation[1] += 0.25 * (std::f64::consts::PI * k as f64 / 60.0).sin();
        let found = detector.detect(renderer.render(&pose)).unwrap();
        let under_way = transit.expose(found.clone(), 33_333_333 * k);
        let mut delivered = 0;
        while transit.deliver(33_333_333 * k).is_some() {
            delivered += 1;
        }
        (detector.visible(), !under_way, delivered)
    };
    // The first frame makes what is made once.
    frame(0);
    let before = COUNT.get();
    let mut bits = [0; 61];
    let mut delivered = 0;
    for k in 1..61 {
        let (visible, _, arrived) = frame(k);
        bits[k as usize] = visible;
        delivered += arrived;
    }
    assert_eq!(COUNT.get() - before, 0);
    assert!(bits.contains(&0) && bits[60] == 0b1111 && delivered > 40);
}
