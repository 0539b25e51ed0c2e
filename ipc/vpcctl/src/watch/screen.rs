//! The screen: pure drawing of what is known at an instant.

use std::path::Path;

use ipc::{Hold, TwistState};
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Borders, Paragraph};

use super::plane;
use crate::phase::{BOUNDS, Phase, Times};
use crate::request::strategy_name;
use crate::stage::Stage;
use crate::view::View;
use crate::words::{duration, faults, pixels};

/// Least columns of the panels beside the image.
const PANELS: u16 = 32;
/// Rows of the panel of twists, title and all.
const TWISTS: u16 = 7;
/// Rows of the panel of numbers, title and all.
const NUMBERS: u16 = 6;
/// What the percentiles look back on, ns.
const WINDOW_NS: u64 = 10_000_000_000;

/// What is drawn.
#[derive(Debug)]
pub struct Screen<'a> {
    /// What is known.
    pub view: &'a View,
    /// The image plane.
    pub stage: &'a Stage,
    /// The domain's directory.
    pub domain: &'a Path,
    /// The daemon's process.
    pub process: Option<u32>,
    /// Services that could not be watched.
    pub full: &'a [&'static str],
    /// The answer to the last request.
    pub message: &'a str,
    /// The present, CLOCK_MONOTONIC, ns.
    pub now_ns: u64,
    /// Whether colours may be used.
    pub colours: bool,
}

impl Screen<'_> {
    /// The colour, where colours may be used.
    pub fn color(&self, color: Color) -> Color {
        match self.colours {
            true => color,
            false => Color::Reset,
        }
    }

    fn state_style(&self, state: TwistState) -> Style {
        let color = match state {
            TwistState::Moving | TwistState::Arrived => Color::Green,
            TwistState::Braking | TwistState::Disarmed => Color::Yellow,
            TwistState::Holding | TwistState::Stopped => Color::Red,
        };
        Style::new()
            .fg(self.color(color))
            .add_modifier(Modifier::BOLD)
    }
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
    let size = screen.stage.size(screen.view);
    let most = middle.width.saturating_sub(PANELS);
    let width = plane::columns(middle.height, size).min(most);
    let [image, panels] =
        Layout::horizontal([Constraint::Length(width), Constraint::Fill(1)]).areas(middle);
    let height = plane::rows(width, size).min(image.height);
    plane::draw(frame, Rect { height, ..image }, screen);
    let [twists, times, numbers] = Layout::vertical([
        Constraint::Length(TWISTS),
        Constraint::Fill(1),
        Constraint::Length(NUMBERS),
    ])
    .areas(panels);
    frame.render_widget(headline(screen), head);
    twist_panel(frame, twists, screen);
    histogram_panel(frame, times, screen);
    number_panel(frame, numbers, screen);
    past_panel(frame, past, screen);
    frame.render_widget(Line::from(format!(" {}", screen.message)), answer);
    let help = " q quit  a arm  d disarm  s stop  1 previous  2 knn  3 gpr  4 ibvs  f flight";
    let style = Style::new().fg(screen.color(Color::DarkGray));
    frame.render_widget(Line::styled(help, style), keys);
}

/// One line: who, state, strategy, clock.
fn headline<'a>(screen: &Screen) -> Line<'a> {
    let who = match screen.process {
        Some(process) => format!(" vpcd {process}  "),
        None => " no vpcd  ".to_owned(),
    };
    let mut spans = vec![Span::raw(who)];
    let Some(last) = screen.view.latest() else {
        let domain = screen.domain.display();
        spans.push(Span::raw(format!("waiting for cycles in {domain}")));
        return Line::from(spans);
    };
    if let Some(state) = TwistState::from_code(last.state) {
        let style = screen.state_style(state).add_modifier(Modifier::REVERSED);
        spans.push(Span::styled(format!(" {state} "), style));
    }
    if let Some(hold) = last.hold().filter(|&hold| hold != Hold::None) {
        spans.push(Span::raw(format!(" {hold}")));
    }
    let strategy = strategy_name(last.strategy, last.neighbours);
    let rate = screen.view.rate_hz().unwrap_or(0.0);
    spans.push(Span::raw(format!(
        "  {strategy} np {}  {rate:.1} Hz",
        last.np
    )));
    let silence = screen.view.silence_ns(screen.now_ns).unwrap_or(0);
    if silence > 500_000_000 {
        let style = Style::new().fg(screen.color(Color::Red));
        let text = format!("  no cycle for {}", duration(silence));
        spans.push(Span::styled(text, style));
    }
    Line::from(spans)
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

fn twist_panel(frame: &mut Frame, area: Rect, screen: &Screen) {
    let limits = screen.stage.limits(screen.view);
    let twist = screen.view.latest().map_or([0.0; 6], |last| last.twist);
    let width = usize::from(area.width).saturating_sub(14);
    let lines = ["vx", "vy", "vz", "wx", "wy", "wz"]
        .iter()
        .enumerate()
        .map(|(i, name)| {
            let share = twist[i] / limits[i];
            let color = match share.abs() >= 0.999 {
                true => Color::Yellow,
                false => Color::Cyan,
            };
            Line::from(vec![
                Span::raw(format!("{name} ")),
                Span::styled(bar(share, width), Style::new().fg(screen.color(color))),
                Span::raw(format!("{:+.3}", twist[i])),
            ])
        });
    let title = format!(
        " twist, limits {:.2} m/s {:.2} rad/s ",
        limits[0], limits[3]
    );
    let panel = Paragraph::new(lines.collect::<Vec<_>>()).block(titled(&title));
    frame.render_widget(panel, area);
}

/// Eighths of a character's height.
const LEVELS: [char; 9] = [' ', '▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];

fn histogram_panel(frame: &mut Frame, area: Rect, screen: &Screen) {
    let block = titled(" cycle time, since watching ");
    let inner = block.inner(area);
    frame.render_widget(block, area);
    if inner.height < 2 {
        return;
    }
    let counts = &screen.view.histograms[Phase::Cycle as usize].counts;
    let most = counts.iter().copied().max().unwrap_or(0).max(1);
    let wide = usize::from(inner.width) / counts.len();
    let rows = usize::from(inner.height) - 1;
    // What happened at all is seen: at least an eighth of a character.
    let eighths = |count: u64| match count {
        0 => 0,
        _ => ((count as f64 / most as f64 * (8 * rows) as f64).round() as usize).max(1),
    };
    let mut lines: Vec<Line> = (0..rows)
        .map(|row| {
            let below = 8 * (rows - 1 - row);
            let columns = counts.iter().flat_map(|&count| {
                let level = eighths(count).saturating_sub(below).min(8);
                std::iter::repeat_n(LEVELS[level], wide.max(1))
            });
            let style = Style::new().fg(screen.color(Color::Cyan));
            Line::styled(columns.collect::<String>(), style)
        })
        .collect();
    // A label below the bucket that ends at each power of ten.
    let mut axis = String::new();
    for (bucket, bound) in BOUNDS.iter().enumerate().step_by(3) {
        let gap = (bucket * wide.max(1)).saturating_sub(axis.chars().count());
        let label = match bound {
            0..1_000_000 => format!("{}u", bound / 1_000),
            _ => format!("{}m", bound / 1_000_000),
        };
        axis += &format!("{}{label}", " ".repeat(gap));
    }
    lines.push(Line::from(axis));
    frame.render_widget(Paragraph::new(lines), inner);
}

fn number_panel(frame: &mut Frame, area: Rect, screen: &Screen) {
    let view = screen.view;
    let block = titled(" numbers, p50 / p99 ");
    let Some(last) = view.latest() else {
        frame.render_widget(block, area);
        return;
    };
    let times = Times::of(view.recent(WINDOW_NS).map(|record| Phase::Cycle.of(record)));
    let wake = Times::of(view.recent(WINDOW_NS).map(|record| Phase::Wake.of(record)));
    let age = match last.features_sequence {
        0 => "-".to_owned(),
        _ => duration(last.features_age_ns),
    };
    let robot = view
        .robot_at(screen.now_ns)
        .map_or("silent".to_owned(), |state| {
            let mode = state
                .mode()
                .map_or("unknown".to_owned(), |mode| mode.to_string());
            let names = faults(state.faults());
            match names.is_empty() {
                true => mode,
                false => format!("{mode}: {}", names.join(", ")),
            }
        });
    let missed = last.overruns + last.lost_records + view.missed;
    let counted = match missed {
        0 => Style::new(),
        _ => Style::new().fg(screen.color(Color::Yellow)),
    };
    let lines = vec![
        Line::from(format!(
            "cycle {} / {}",
            duration(times.p50_ns),
            duration(times.p99_ns)
        )),
        Line::from(format!(
            "wake  {} / {}",
            duration(wake.p50_ns),
            duration(wake.p99_ns)
        )),
        Line::styled(
            format!(
                "overruns {} lost {} missed {}",
                last.overruns, last.lost_records, view.missed
            ),
            counted,
        ),
        Line::from(format!(
            "err {} clear {}",
            pixels(last.error_px),
            pixels(last.clearance_px)
        )),
        Line::from(format!("age {age}, robot {robot}")),
    ];
    frame.render_widget(Paragraph::new(lines).block(block), area);
}

fn past_panel(frame: &mut Frame, area: Rect, screen: &Screen) {
    let mut lines: Vec<Line> = screen
        .view
        .changes()
        .rev()
        .map(|change| {
            let ago = duration(screen.now_ns.saturating_sub(change.at_ns));
            let mut spans = vec![
                Span::raw(format!("{ago:>8} ago  ")),
                Span::styled(change.state.to_string(), screen.state_style(change.state)),
            ];
            if change.hold != Hold::None {
                spans.push(Span::raw(format!(": {}", change.hold)));
            }
            Line::from(spans)
        })
        .collect();
    if !screen.full.is_empty() {
        let services = screen.full.join(", ");
        let style = Style::new().fg(screen.color(Color::Red));
        lines.insert(
            0,
            Line::styled(format!("not seen, all places taken: {services}"), style),
        );
    }
    let block = titled(" state and cause, newest first ");
    frame.render_widget(Paragraph::new(lines).block(block), area);
}

#[cfg(test)]
mod tests {
    use ipc::{CycleRecord, Order, Received, RobotFaults, RobotState};
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;
    use scene::Scene;

    use super::*;
    use crate::view::tests::record;

    /// Three seconds of a run: a hold, then features on their way, a way point, a rare slow cycle.
    fn run() -> View {
        let mut view = View::default();
        for number in 1..=300 {
            let (state, hold) = match number {
                ..=40 => (TwistState::Holding, Hold::Hidden),
                _ => (TwistState::Moving, Hold::None),
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

    fn picture(columns: u16, rows: u16, view: &View, stage: &Stage) -> String {
        let screen = Screen {
            view,
            stage,
            domain: Path::new("/tmp/vpc-1000"),
            process: Some(4321),
            full: &[],
            message: "arm: done; moving, strategy knn5",
            now_ns: 3_020_000_000,
            colours: true,
        };
        let mut terminal = Terminal::new(TestBackend::new(columns, rows)).unwrap();
        terminal.draw(|frame| draw(frame, &screen)).unwrap();
        terminal.backend().to_string()
    }

    fn paper() -> Stage {
        Stage::new(Scene::parse(scene::PAPER_SIM, "paper-sim.toml").unwrap())
    }

    #[test]
    fn a_run_on_a_small_terminal() {
        insta::assert_snapshot!(picture(80, 24, &run(), &paper()));
    }

    #[test]
    fn a_run_on_a_large_terminal() {
        insta::assert_snapshot!(picture(160, 50, &run(), &paper()));
    }

    #[test]
    fn a_run_before_a_painted_mask() {
        // A ring, and a scratch three pixels wide: a dot stands for five.
        let stage = crate::stage::tests::painted(|i, j| {
            let square = i.abs_diff(300).pow(2) + j.abs_diff(700).pow(2);
            (120 * 120..200 * 200).contains(&square) || (j.abs_diff(i / 4 + 100) < 2 && i > 200)
        });
        insta::assert_snapshot!(picture(160, 50, &run(), &stage));
    }

    #[test]
    fn a_run_without_a_scene() {
        insta::assert_snapshot!(picture(80, 24, &run(), &Stage::default()));
    }

    #[test]
    fn nothing_yet() {
        insta::assert_snapshot!(picture(80, 24, &View::default(), &paper()));
    }

    #[test]
    fn any_size_is_drawn_without_a_panic() {
        let (view, stage) = (run(), paper());
        for (columns, rows) in [(1, 1), (10, 3), (33, 9), (300, 5), (5, 80)] {
            picture(columns, rows, &view, &stage);
        }
    }

    #[test]
    fn bars_grow_from_the_middle_and_stay_inside() {
        assert_eq!(bar(0.5, 8), "    │██  ");
        assert_eq!(bar(-1.0, 8), "████│    ");
        assert_eq!(bar(7.0, 8), "    │████");
    }
}
