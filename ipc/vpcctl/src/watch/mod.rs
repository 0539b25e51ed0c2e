//! `vpcctl watch`: a live view in the terminal.

mod pending;
mod plane;
mod screen;

use std::io::IsTerminal;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use ipc::{Action, Domain, StrategyCode};
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

use rustix::event::{PollFd, PollFlags, Timespec};
use rustix::io::Errno;

use crate::exit::{Exit, Failure};
use crate::output;
use crate::presence::Presence;
use crate::request;
use crate::stage::Stage;
use crate::watcher::Watcher;

use pending::Pending;
pub use screen::{Screen, draw};

/// Time between two pictures.
const FRAME: Duration = Duration::from_millis(50);
/// Time between two looks for the daemon's process.
const LOOK: Duration = Duration::from_secs(1);

/// What a key asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wish {
    Quit,
    Ask(Action),
    Strategy(StrategyCode),
}

fn wish(key: &KeyEvent) -> Option<Wish> {
    if key.kind == KeyEventKind::Release {
        return None;
    }
    let control = key.modifiers.contains(KeyModifiers::CONTROL);
    match key.code {
        KeyCode::Char('c') if control => Some(Wish::Quit),
        KeyCode::Char('q') | KeyCode::Esc => Some(Wish::Quit),
        KeyCode::Char('a') => Some(Wish::Ask(Action::Arm)),
        KeyCode::Char('d') => Some(Wish::Ask(Action::Disarm)),
        KeyCode::Char('s' | ' ') => Some(Wish::Ask(Action::Stop)),
        KeyCode::Char('f') => Some(Wish::Ask(Action::Record)),
        KeyCode::Char('1') => Some(Wish::Strategy(StrategyCode::Previous)),
        KeyCode::Char('2') => Some(Wish::Strategy(StrategyCode::Knn)),
        KeyCode::Char('3') => Some(Wish::Strategy(StrategyCode::Gpr)),
        KeyCode::Char('4') => Some(Wish::Strategy(StrategyCode::Ibvs)),
        _ => None,
    }
}

/// Shows the domain until `q`, Ctrl-C, SIGTERM or SIGHUP. A daemon may start, end and start again meanwhile.
///
/// # Errors
/// [`Failure::NoDaemon`] where there is no domain; what stands against joining it or using the terminal.
pub fn run(directory: &Path, stage: &Stage, neighbours: u32) -> Result<Exit, Failure> {
    if Presence::of(directory) == Presence::NoDomain {
        let domain = directory.display().to_string();
        return Err(Failure::NoDaemon { domain });
    }
    if !(std::io::stdout().is_terminal() && std::io::stdin().is_terminal()) {
        return Err(Failure::NoTerminal);
    }
    let domain = Domain::join(directory)?;
    let mut watcher = Watcher::open(&domain)?;
    let end = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGHUP] {
        signal_hook::flag::register(signal, Arc::clone(&end))?;
    }
    end_at_last(Arc::clone(&end));
    // Restores the terminal also when we panic.
    let mut terminal = ratatui::try_init()?;
    let result = show(
        &mut terminal,
        &domain,
        &mut watcher,
        stage,
        neighbours,
        &end,
    );
    ratatui::try_restore()?;
    result.map(|()| Exit::Ok)
}

/// What the terminal says.
enum Heard {
    Nothing,
    Keys,
    HangUp,
}

/// Waits a frame for keys. crossterm 0.29 reads a terminal that is gone (a dropped connection) for ever, at full speed:
/// it is asked only where there is something to read.
fn heard() -> std::io::Result<Heard> {
    let input = std::io::stdin();
    let mut ports = [PollFd::new(&input, PollFlags::IN)];
    let frame = Timespec {
        tv_sec: 0,
        tv_nsec: i64::from(FRAME.subsec_nanos()),
    };
    match rustix::event::poll(&mut ports, Some(&frame)) {
        // A change of the window's size: the next picture has it.
        Err(Errno::INTR) => return Ok(Heard::Nothing),
        result => result?,
    };
    let found = ports[0].revents();
    if found.intersects(PollFlags::HUP | PollFlags::ERR | PollFlags::NVAL) {
        return Ok(Heard::HangUp);
    }
    match found.contains(PollFlags::IN) && event::poll(Duration::ZERO)? {
        true => Ok(Heard::Keys),
        false => Ok(Heard::Nothing),
    }
}

/// Ends the process a second after it was asked to, should it hang in reading a terminal that went at a bad instant.
fn end_at_last(end: Arc<AtomicBool>) {
    std::thread::spawn(move || {
        while !end.load(Ordering::Relaxed) {
            std::thread::sleep(LOOK / 5);
        }
        std::thread::sleep(LOOK);
        // The terminal may be gone.
        let _ = ratatui::try_restore();
        std::process::exit(Exit::Ok as i32);
    });
}

fn show(
    terminal: &mut ratatui::DefaultTerminal,
    domain: &Domain,
    watcher: &mut Watcher,
    stage: &Stage,
    neighbours: u32,
    end: &AtomicBool,
) -> Result<(), Failure> {
    let directory = domain.directory();
    let colours = output::colours();
    let mut pending: Option<Pending> = None;
    let mut message = String::new();
    let (mut process, mut looked) = (Presence::of(directory).process(), Instant::now());
    while !end.load(Ordering::Relaxed) {
        watcher.poll()?;
        if let Some(answer) = pending.as_mut().and_then(Pending::poll) {
            (message, pending) = (answer, None);
        }
        if looked.elapsed() >= LOOK {
            (process, looked) = (Presence::of(directory).process(), Instant::now());
        }
        let screen = Screen {
            view: &watcher.view,
            stage,
            domain: directory,
            process,
            full: &watcher.full,
            message: &message,
            now_ns: ipc::now_ns(),
            colours,
        };
        terminal.draw(|frame| draw(frame, &screen))?;
        match heard()? {
            Heard::Nothing => continue,
            Heard::HangUp => break,
            Heard::Keys => (),
        }
        let Event::Key(key) = event::read()? else {
            continue;
        };
        let asked = match wish(&key) {
            Some(Wish::Quit) => break,
            Some(Wish::Ask(action)) => request::plain(action),
            Some(Wish::Strategy(StrategyCode::Knn)) => {
                request::strategy(StrategyCode::Knn, neighbours)
            }
            Some(Wish::Strategy(strategy)) => request::strategy(strategy, 0),
            None => continue,
        };
        // A newer request replaces one that nobody has answered: stop must not wait for arm.
        pending = None;
        match Pending::ask(domain, asked) {
            Ok(asked) => {
                message = format!("{}: asked", asked.action());
                pending = Some(asked);
            }
            Err(error) => message = error.to_string(),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn space_and_s_stop_and_letters_do_what_the_last_line_says() {
        let press = |code| wish(&KeyEvent::new(code, KeyModifiers::NONE));
        for code in [KeyCode::Char('s'), KeyCode::Char(' ')] {
            assert_eq!(press(code), Some(Wish::Ask(Action::Stop)));
        }
        assert_eq!(press(KeyCode::Char('a')), Some(Wish::Ask(Action::Arm)));
        assert_eq!(press(KeyCode::Char('d')), Some(Wish::Ask(Action::Disarm)));
        assert_eq!(
            press(KeyCode::Char('3')),
            Some(Wish::Strategy(StrategyCode::Gpr))
        );
        assert_eq!(press(KeyCode::Char('x')), None);
        let interrupt = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
        assert_eq!(wish(&interrupt), Some(Wish::Quit));
    }
}
