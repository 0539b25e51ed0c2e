//! The screen: draws a view at an instant; pure.

use messages::StrategyCode;
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Bar, BarChart, Block, Borders, Paragraph};

use super::palette::Palette;
use super::plane;
use crate::image_plane::ImagePlane;
use crate::joints::{Joint, joints};
use crate::latency::{BOUNDS, CYCLE, Percentiles, WAKE, durations};
use crate::output::Tone;
use crate::status::Status;
use crate::units::{duration, pixels};

/// Least columns of the panels beside the image.
const PANELS: u16 = 32;
/// Rows of the panel of twists, with its title.
const TWISTS: u16 = 7;
/// Rows of the panel of numbers, with its title.
const NUMBERS: u16 = 6;
/// Rows of the histogram beside a panel of joints; with fewer it makes room.
const HISTOGRAM: u16 = 4;
/// What the percentiles look back on, ns.
const WINDOW_NS: u64 = 10_000_000_000;
/// What the keys do, within 80 columns.
fn help() -> String {
    let names = StrategyCode::TABLE.names.iter();
    let strategies = names.map(|name| format!(" {} {}", name.number + 1, name.text));
    let strategies: String = strategies.collect();
    format!("q quit a arm d disarm s stop f flight {strategies}")
}

/// What is drawn.
#[derive(Debug)]
pub struct Screen<'a> {
    /// What is known.
    pub status: &'a Status,
    /// The image plane.
    pub plane: &'a ImagePlane,
    /// The answer to the last request.
    pub message: &'a str,
    /// Colours.
    pub palette: Palette,
}

/// Draws the screen; 80 x 24 characters are enough for all of it.
pub fn draw(frame: &mut Frame, screen: &Screen) {
    let events = if frame.area().height >= 40 { 8 } else { 3 };
    let [head, middle, past, answer, keys] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Fill(1),
        Constraint::Length(events),
        Constraint::Length(1),
        Constraint::Length(1),
    ])
    .areas(frame.area());
    let view = &screen.status.view;
    let size = screen.plane.size(view);
    let most = middle.width.saturating_sub(PANELS);
    let width = plane::columns(middle.height, size).min(most);
    let [image, panels] =
        Layout::horizontal([Constraint::Length(width), Constraint::Fill(1)]).areas(middle);
    let height = plane::rows(width, size).min(image.height);
    plane::draw(
        frame,
        Rect { height, ..image },
        screen.plane,
        view,
        screen.palette,
    );
    let joints = joints(view, screen.status.now_ns);
    let free = panels.height.saturating_sub(TWISTS + NUMBERS);
    // A row for each joint, or for each two.
    let all = joints.len() as u16;
    let rows = match all {
        0 => 0,
        _ if free > all + HISTOGRAM => all + 1,
        _ => free.min(all.div_ceil(2) + 1),
    };
    let [twists, arm, times, numbers] = Layout::vertical([
        Constraint::Length(TWISTS),
        Constraint::Length(rows),
        Constraint::Fill(1),
        Constraint::Length(NUMBERS),
    ])
    .areas(panels);
    frame.render_widget(headline(screen), head);
    twist_panel(frame, twists, screen);
    joint_panel(frame, arm, screen, &joints);
    histogram_panel(frame, times, screen);
    number_panel(frame, numbers, screen);
    past_panel(frame, past, screen);
    frame.render_widget(Line::from(format!(" {}", screen.message)), answer);
    let style = screen.palette.style(Color::DarkGray);
    frame.render_widget(Line::styled(help(), style), keys);
}

/// One line: process, state, cause, strategy, rate.
fn headline<'a>(screen: &Screen) -> Line<'a> {
    let status = screen.status;
    let who = match status.process {
        Some(process) => format!(" vpcd {process}  "),
        None => " no vpcd  ".to_owned(),
    };
    let (state, cause, tone) = status.headline();
    let Some(last) = status.view.latest() else {
        let domain = status.directory.display();
        return Line::from(format!("{who}{state} in {domain}"));
    };
    let style = screen.palette.tone(tone).add_modifier(Modifier::REVERSED);
    let cause = cause.map(|cause| format!(" {cause}")).unwrap_or_default();
    let strategy = status.strategy().unwrap_or_default();
    let rate = status.view.rate_hz().unwrap_or(0.0);
    Line::from(vec![
        Span::raw(who),
        Span::styled(format!(" {state} "), style),
        Span::raw(format!("{cause}  {strategy} np {}  {rate:.1} Hz", last.np)),
    ])
}

/// A panel under a line with its title: rows are scarce.
fn titled(title: &str) -> Block<'_> {
    Block::new().borders(Borders::TOP).title(title)
}

/// A bar of `width` characters from its middle, `share` from -1 to 1.
fn bar(share: f64, width: usize) -> String {
    let half = width / 2;
    let filled = ((share.abs().min(1.0) * half as f64).round() as usize).min(half);
    let (full, empty) = ("█".repeat(filled), " ".repeat(half - filled));
    let blank = " ".repeat(half);
    match share < 0.0 {
        true => format!("{empty}{full}│{blank}"),
        false => format!("{blank}│{full}{empty}"),
    }
}

/// The same bar with a mark where the pattern's own motion is, if it moves.
fn marked(bar: String, share: f64) -> String {
    if share == 0.0 {
        return bar;
    }
    let half = bar.chars().count() / 2;
    let place = half as f64 * (1.0 + share.clamp(-1.0, 1.0));
    let marks = bar.chars().enumerate();
    let marks = marks.map(|(k, c)| {
        if k == place.round() as usize {
            '◆'
        } else {
            c
        }
    });
    marks.collect()
}

fn twist_panel(frame: &mut Frame, area: Rect, screen: &Screen) {
    let view = &screen.status.view;
    let [linear, angular] = screen.plane.limits(view);
    let [twist, drift] = view
        .latest()
        .map_or([[0.0; 6]; 2], |last| [last.twist, last.drift]);
    let width = usize::from(area.width).saturating_sub(14);
    let names = ["vx", "vy", "vz", "wx", "wy", "wz"];
    let lines = names.iter().enumerate().map(|(i, name)| {
        let share = twist[i] / if i < 3 { linear } else { angular };
        let color = match share.abs() >= 0.999 {
            true => Color::Yellow,
            false => Color::Cyan,
        };
        let own = drift[i] / if i < 3 { linear } else { angular };
        Line::from(vec![
            Span::raw(format!("{name} ")),
            Span::styled(marked(bar(share, width), own), screen.palette.style(color)),
            Span::raw(format!("{:+.3}", twist[i])),
        ])
    });
    let title = format!(" twist, limits {linear:.2} m/s {angular:.2} rad/s ");
    let panel = Paragraph::new(lines.collect::<Vec<_>>()).block(titled(&title));
    frame.render_widget(panel, area);
}

/// Where each joint is in its range.
fn joint_panel(frame: &mut Frame, area: Rect, screen: &Screen, joints: &[Joint]) {
    let rows = usize::from(area.height.saturating_sub(1)).max(1);
    let columns = joints.len().div_ceil(rows);
    if columns == 0 {
        return;
    }
    let width = usize::from(area.width) / columns;
    let cell = |k: usize| {
        let joint = joints.get(k)?;
        let color = match joint.binds {
            true => Color::Yellow,
            false => Color::Cyan,
        };
        let style = screen.palette.style(color);
        let mark = if joint.binds { '!' } else { ' ' };
        Some(match columns {
            1 => {
                let track = joint.track(width.saturating_sub(14));
                vec![
                    Span::raw(format!("q{} ", k + 1)),
                    Span::styled(format!("{track}{mark}"), style),
                    Span::raw(format!("{:+.2} {}", joint.q, joint.unit)),
                ]
            }
            _ => vec![
                Span::raw(format!("q{} ", k + 1)),
                Span::styled(
                    format!("{}{mark} ", joint.track(width.saturating_sub(5))),
                    style,
                ),
            ],
        })
    };
    let lines = (0..rows).map(|row| {
        let cells = (0..columns).filter_map(|column| cell(column * rows + row));
        Line::from(cells.flatten().collect::<Vec<_>>())
    });
    let bound = screen.status.view.bound();
    let title = bound.map_or(" joints ".to_owned(), |bound| format!(" {bound} "));
    let panel = Paragraph::new(lines.collect::<Vec<_>>()).block(titled(&title));
    frame.render_widget(panel, area);
}

fn histogram_panel(frame: &mut Frame, area: Rect, screen: &Screen) {
    let [above, below] = Layout::vertical([Constraint::Fill(1), Constraint::Length(1)]).areas(area);
    let counts = &screen.status.view.histograms[CYCLE].counts;
    let most = counts.iter().copied().max().unwrap_or(0).max(1);
    let width = (area.width / counts.len() as u16).max(1);
    // What happened at all is seen: at least an eighth of a character.
    let least = most.div_ceil(8 * u64::from(above.height.max(2) - 1));
    let bars = counts.iter().map(|&count| {
        let height = if count == 0 { 0 } else { count.max(least) };
        Bar::default().value(height).text_value("")
    });
    let chart = BarChart::new(bars.collect::<Vec<_>>())
        .block(titled(" cycle time, since watching "))
        .bar_style(screen.palette.style(Color::Cyan))
        .bar_width(width)
        .bar_gap(0)
        .max(most);
    frame.render_widget(chart, above);
    // A label below the bucket that ends at each power of ten.
    let labels = BOUNDS.iter().step_by(3).map(|bound| {
        let label = match bound {
            0..1_000_000 => format!("{}u", bound / 1_000),
            _ => format!("{}m", bound / 1_000_000),
        };
        format!("{label:<0$}", 3 * usize::from(width))
    });
    frame.render_widget(Line::from(labels.collect::<String>()), below);
}

fn number_panel(frame: &mut Frame, area: Rect, screen: &Screen) {
    let (status, view) = (screen.status, &screen.status.view);
    let block = titled(" numbers, p50 / p99 ");
    let Some(last) = view.latest() else {
        frame.render_widget(block, area);
        return;
    };
    let times = |name: &str, stage: usize| {
        let of = Percentiles::of(
            view.recent(WINDOW_NS)
                .map(|record| durations(record)[stage]),
        );
        Line::from(format!(
            "{name} {} / {}",
            duration(of.p50_ns),
            duration(of.p99_ns)
        ))
    };
    let missed = last.overruns + last.lost_records + view.missed;
    let counted = match missed {
        0 => Style::new(),
        _ => screen.palette.style(Color::Yellow),
    };
    let counts = format!(
        "overruns {} lost {} missed {}",
        last.overruns, last.lost_records, view.missed
    );
    // Of the newest features, also after the end of a run.
    let seen = view.seen.as_ref().unwrap_or(last);
    let (error, clearance) = (pixels(seen.error_px), pixels(seen.clearance_px));
    let age = match (
        view.camera_silence_ns(status.now_ns),
        last.features_sequence,
    ) {
        (Some(silence), _) => format!("camera silent for {}", duration(silence)),
        (None, 0) => "age -".to_owned(),
        (None, _) => format!("age {}", duration(last.features_age_ns)),
    };
    let lines = vec![
        times("cycle", CYCLE),
        times("wake ", WAKE),
        Line::styled(counts, counted),
        Line::from(format!("err {error} clear {clearance}")),
        Line::from(format!("{age}, robot {}", view.robot_words(status.now_ns))),
    ];
    frame.render_widget(Paragraph::new(lines).block(block), area);
}

fn past_panel(frame: &mut Frame, area: Rect, screen: &Screen) {
    let (status, palette) = (screen.status, screen.palette);
    let mut lines = Vec::new();
    if !status.full.is_empty() {
        let services = status.full.join(", ");
        let text = format!("not seen, all slots taken: {services}");
        lines.push(Line::styled(text, palette.tone(Tone::Bad)));
    }
    lines.extend(status.view.changes().rev().map(|change| {
        let ago = duration(status.now_ns.saturating_sub(change.at_ns));
        let tone = Tone::of(change.state, change.hold);
        let cause = (change.hold).map_or(String::new(), |hold| format!(": {hold}"));
        Line::from(vec![
            Span::raw(format!("{ago:>8} ago  ")),
            Span::styled(change.state.to_string(), palette.tone(tone)),
            Span::raw(cause),
        ])
    }));
    let block = titled(" state and cause, newest first ");
    frame.render_widget(Paragraph::new(lines).block(block), area);
}

#[cfg(test)]
mod tests {
    use messages::{CycleRecord, Order, Received, RobotFaults, RobotState, TwistState};
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    use messages::Hold;

    use super::*;
    use crate::image_plane::tests::{painted, paper};
    use crate::joints::tests::with_arm;
    use crate::view::View;
    use crate::view::tests::record;

    const NOW_NS: u64 = 3_020_000_000;

    /// Three seconds of a run: a hold, then features on their way, a way point, a rare slow cycle.
    fn run() -> View {
        let mut view = View::default();
        for number in 1..=300 {
            let (state, hold) = match number {
                ..=40 => (TwistState::Holding, Some(Hold::Hidden)),
                _ => (TwistState::Moving, None),
            };
            let far = (300 - number) as f64;
            let mut points = [0.0; 16];
            for (i, corner) in [
                [700.0, 500.0],
                [900.0, 500.0],
                [900.0, 700.0],
                [700.0, 700.0],
            ]
            .iter()
            .enumerate()
            {
                points[2 * i] = corner[0] - 2.0 * far;
                points[2 * i + 1] = corner[1] + far;
            }
            let message = CycleRecord {
                receive_ns: 2_000,
                step_ns: if number == 200 {
                    3_000_000
                } else {
                    12_000 + 100 * number
                },
                send_ns: 3_000,
                wake_latency_ns: 60_000,
                features_sequence: number,
                features_age_ns: 33_000_000,
                count: 4,
                way_point_count: 4,
                way_point: points.map(|x| if x > 0.0 { x + 60.0 } else { 0.0 }),
                points,
                np: 3,
                overruns: 1,
                strategy: 1,
                neighbours: 5,
                twist: [0.5, -0.25, 0.1, 0.0, -1.0, 0.2],
                error_px: 2.0 * far,
                clearance_px: 31.5,
                ..record(number, state, hold)
            };
            let order = Order::Next;
            view.cycle(&Received { message, order });
        }
        let mut robot = RobotState::free_camera([0.0, 0.0, 0.5], [0.0; 3], 0);
        robot.mode = 1;
        robot.stamp.published_ns = 3_000_000_000;
        robot.faults = RobotFaults::COMMAND_LIMITED.0;
        view.robot = Some(robot);
        view
    }

    fn picture(columns: u16, rows: u16, view: &View, plane: &ImagePlane, now_ns: u64) -> String {
        let mut status = Status::default();
        status.directory = "/tmp/vpc-1000".into();
        status.process = Some(4321);
        (status.view, status.now_ns) = (view.clone(), now_ns);
        let screen = Screen {
            status: &status,
            plane,
            message: "arm: done; moving, strategy knn5",
            palette: Palette { colours: true },
        };
        let mut terminal = Terminal::new(TestBackend::new(columns, rows)).unwrap();
        terminal.draw(|frame| draw(frame, &screen)).unwrap();
        terminal.backend().to_string()
    }

    #[test]
    fn a_run_on_a_small_terminal() {
        insta::assert_snapshot!(picture(80, 24, &run(), &paper(), NOW_NS));
    }

    #[test]
    fn a_run_on_a_large_terminal() {
        insta::assert_snapshot!(picture(160, 50, &run(), &paper(), NOW_NS));
    }

    #[test]
    fn a_run_before_a_painted_mask() {
        // A ring, and a scratch three pixels wide: a dot stands for five.
        let plane = painted(|i, j| {
            let square = i.abs_diff(300).pow(2) + j.abs_diff(700).pow(2);
            (120 * 120..200 * 200).contains(&square) || (j.abs_diff(i / 4 + 100) < 2 && i > 200)
        });
        insta::assert_snapshot!(picture(160, 50, &run(), &plane, NOW_NS));
    }

    #[test]
    fn a_run_without_a_scene() {
        insta::assert_snapshot!(picture(80, 24, &run(), &ImagePlane::default(), NOW_NS));
    }

    #[test]
    fn a_run_whose_camera_ended() {
        let mut view = run();
        for number in 301..=600 {
            let message = record(number, TwistState::Holding, Hold::Stale);
            let order = Order::Next;
            view.cycle(&Received { message, order });
        }
        insta::assert_snapshot!(picture(80, 24, &view, &paper(), 6_010_000_000));
    }

    #[test]
    fn nothing_yet() {
        insta::assert_snapshot!(picture(80, 24, &View::default(), &paper(), NOW_NS));
    }

    #[test]
    fn an_arm_whose_joint_binds_on_a_large_terminal() {
        let view = with_arm(run(), NOW_NS);
        insta::assert_snapshot!(picture(160, 50, &view, &paper(), NOW_NS));
    }

    #[test]
    fn an_arm_whose_joint_binds_on_a_small_terminal() {
        let view = with_arm(run(), NOW_NS);
        insta::assert_snapshot!(picture(80, 24, &view, &paper(), NOW_NS));
    }

    #[test]
    fn any_size_is_drawn_without_a_panic() {
        let plane = paper();
        for view in [run(), with_arm(run(), NOW_NS)] {
            for (columns, rows) in [(1, 1), (10, 3), (33, 9), (300, 5), (5, 80), (40, 20)] {
                picture(columns, rows, &view, &plane, NOW_NS);
            }
        }
    }

    #[test]
    fn bars_grow_from_the_middle_and_stay_inside() {
        assert_eq!(bar(0.5, 8), "    │██  ");
        assert_eq!(bar(-1.0, 8), "████│    ");
        assert_eq!(bar(7.0, 8), "    │████");
    }
}
