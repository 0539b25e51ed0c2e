//! The page of `serve` in a real browser.

use std::path::Path;
use std::time::Duration;

use messages::{Encoding, ImageHeader};

use crate::browser::Browser;
use crate::painted_scene;
use crate::server::Server;
use crate::stand_in::{Camera, StandIn};

/// The page in a real browser; `None`, and a word about it, where there is none.
fn browse(domain: &Path, options: &[&str]) -> Option<(Server, Browser)> {
    let words = [&["serve", "--listen", "127.0.0.1:0"], options].concat();
    let server = Server::start(domain, &words);
    let url = server.line.trim().rsplit(' ').next()?;
    let browser = Browser::open(domain, url);
    if browser.is_none() {
        testkit::not_run("the page in a browser", "no chromium");
    }
    Some((server, browser?))
}

#[test]
fn a_browser_shows_the_painted_mask_where_it_is() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let scene = painted_scene(directory.path());
    let scene = scene.to_str().unwrap();
    let Some((_server, mut browser)) = browse(directory.path(), &["--scene", scene]) else {
        return;
    };
    browser.wait_for("document.getElementById('state').textContent === 'disarmed'");
    // The ring is painted to the left, the right, above and below its middle, which is clear.
    let painted = "(() => { const c = document.getElementById('image'), s = c.width / 1024; \
        const at = (u, v) => c.getContext('2d').getImageData(u * s, v * s, 1, 1).data[3] > 0; \
        return [[140, 700], [460, 700], [300, 540], [300, 860]].every(p => at(...p)) \
        && ![[300, 700], [90, 700], [300, 470], [500, 880]].some(p => at(...p)); })()";
    browser.wait_for(painted);
    // Without --control there is nothing to press.
    browser.wait_for("getComputedStyle(document.getElementById('buttons')).display === 'none'");
    browser.keep_picture(&Path::new(env!("CARGO_TARGET_TMPDIR")).join("serve-mask.png"));
}

/// Of a camera with a square image and of a wide one.
#[test]
fn the_image_fills_its_panel_on_a_desk_and_on_a_phone() {
    for (name, text) in [
        ("sim", scene::PAPER_SIM.to_owned()),
        (
            "wide",
            scene::PAPER_SIM.replacen("height = 1024", "height = 720", 1),
        ),
    ] {
        let directory = tempfile::tempdir().unwrap();
        let _daemon = StandIn::sound(directory.path());
        let path = directory.path().join("scene.toml");
        std::fs::write(&path, text).unwrap();
        let options = ["--scene", path.to_str().unwrap()];
        let Some((_server, mut browser)) = browse(directory.path(), &options) else {
            return;
        };
        browser.wait_for("document.getElementById('state').textContent === 'disarmed'");
        let fills = "(() => { const c = document.getElementById('image'), box = c.parentElement, \
            panel = box.parentElement, title = panel.querySelector('h2'); \
            const bottom = panel.getBoundingClientRect().bottom - c.getBoundingClientRect().bottom; \
            return c.clientWidth > 200 && Math.abs(c.clientWidth - title.clientWidth) <= 1 && bottom < 12 \
            && Math.abs(c.clientWidth / c.clientHeight - scene.size[0] / scene.size[1]) < .01; })()";
        for (width, height) in [(1280, 800), (390, 844), (1280, 800)] {
            browser.resize(width, height);
            // As before the numbers below it were there.
            browser.value("document.getElementById('image').parentElement.style.height = '900px'");
            browser.wait_for(&format!("innerWidth === {width} && {fills}"));
            // Nothing sticks out, and on a desk nothing has to be scrolled to.
            browser.wait_for("document.documentElement.scrollWidth <= innerWidth");
            browser.wait_for(
                "innerWidth < 800 || document.documentElement.scrollHeight <= innerHeight",
            );
            let file = format!("serve-{name}-{width}.png");
            browser.keep_picture(&Path::new(env!("CARGO_TARGET_TMPDIR")).join(file));
        }
    }
}

#[test]
fn trails_break_where_runs_begin_and_features_are_missing() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let Some((_server, mut browser)) = browse(directory.path(), &[]) else {
        return;
    };
    browser.wait_for("document.getElementById('state').textContent === 'disarmed'");
    browser.wait_for("cycles.some(row => Number.isFinite(row[FRAME]))");
    // Time and number of the frame: a run ends with frame 8, and the features of the next stay away
    // for half a second.
    let lengths = "(() => { const row = ([t, frame]) => [t, ...Array(10).fill(0), [[t, 5]], frame]; \
        used = 1; cycles = [[.1, 7], [.2, 8], [.3, 1], [.4, 2], [.5, 3], [1, 18]].map(row); \
        return pieces().map(piece => piece.length).join(); })()";
    assert_eq!(browser.value(lengths), "2,3,1");
}

#[test]
fn a_browser_shows_the_image_of_the_camera_under_the_lines() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let scene = painted_scene(directory.path());
    let Some((_server, mut browser)) =
        browse(directory.path(), &["--scene", scene.to_str().unwrap()])
    else {
        return;
    };
    browser.wait_for("document.getElementById('state').textContent === 'disarmed'");
    browser.wait_for("document.getElementById('camera').hidden");
    // A red square on black, its edges between pixels 399 and 400, 599 and 600.
    let header = ImageHeader::new(1024, 1024, Encoding::Bgr8, 0);
    let camera = Camera::start(directory.path(), header, |u, v| {
        let is_inside = [u, v].iter().all(|x| (400..600).contains(x));
        [0, 0, if is_inside { 255 } else { 0 }]
    });
    let seen = "at = (u, v) => { const c = document.getElementById('image'), s = c.width / 1024; \
        return c.getContext('2d').getImageData(u * s, v * s, 1, 1).data; }; \
        isRed = (u, v) => at(u, v)[0] > 80 && at(u, v)[1] < 20 && at(u, v)[3] > 0; \
        isBlack = (u, v) => at(u, v)[0] < 20 && at(u, v)[3] > 80; 0";
    browser.value(seen);
    browser.wait_for("isRed(500, 450) && isRed(405, 405) && isRed(595, 595)");
    browser.wait_for("isBlack(390, 450) && isBlack(500, 390) && isBlack(610, 500)");
    // The occlusion, the goal and a feature are on top of it.
    browser.wait_for("at(140, 700)[1] > 40 && at(700, 500)[2] > 100 && !isRed(700, 500)");
    browser.keep_picture(&Path::new(env!("CARGO_TARGET_TMPDIR")).join("serve-image.png"));
    // Without it, where one switches it off, the page is as before.
    browser.value("document.getElementById('live').click()");
    browser.wait_for("at(500, 450)[3] === 0 && at(140, 700)[3] > 0");
    browser.value("count = 0; fetch = (f => (...a) => { count++; return f(...a); })(fetch); 0");
    browser.value("document.getElementById('live').click()");
    browser.wait_for("isRed(500, 450)");
    // Ten pictures a second, and none for an image that it has.
    browser.value("count = 0; begin_ms = performance.now(); 0");
    std::thread::sleep(Duration::from_secs(1));
    browser.wait_for("count > 2 && count <= (performance.now() - begin_ms) / 100 + 1");
    drop(camera);
    browser.wait_for("document.getElementById('age').textContent.endsWith('s ago')");
    browser.value("count = 0; 0");
    std::thread::sleep(Duration::from_millis(500));
    browser.wait_for("count === 0 && isRed(500, 450)");
}

#[test]
fn a_browser_shows_the_run_and_its_buttons_command() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let Some((_server, mut browser)) = browse(directory.path(), &["--control"]) else {
        return;
    };
    browser.wait_for("document.getElementById('state').textContent === 'disarmed'");
    browser.wait_for("document.getElementById('cause').textContent === 'not armed'");
    browser.wait_for("document.getElementById('numbers').innerText.includes('25.5 px')");
    browser.wait_for("getComputedStyle(document.getElementById('buttons')).display === 'flex'");
    // Something is painted where feature 0 is, (700, 500) of 1280 x 960 px.
    let pixel = "(() => { const c = document.getElementById('image'); const s = c.width / 1280; \
        return c.getContext('2d').getImageData(700 * s, 500 * s, 1, 1).data[3] > 0; })()";
    browser.wait_for(pixel);
    // As many tabs as a browser has connections, and more.
    browser.value("others = [...Array(8)].map(() => new EventSource('events')); 0");
    browser.value("document.getElementById('arm').click()");
    browser.wait_for("document.getElementById('state').textContent === 'moving'");
    browser.wait_for("document.getElementById('answer').textContent.startsWith('arm: done')");
    browser.value("document.getElementById('stop').click()");
    browser.wait_for("document.getElementById('cause').textContent === 'operator'");
    browser.value("confirm = () => false; document.getElementById('teach').click()");
    browser.wait_for("document.getElementById('answer').textContent.startsWith('stop')");
    // The stand-in has left no configuration.
    browser.value("confirm = () => true; document.getElementById('teach').click()");
    browser.wait_for("document.getElementById('answer').textContent.includes('config/vpcd.toml')");
}
