//! `vpcctl watch`: a live view in the terminal.

mod palette;
mod plane;
mod screen;

use std::io::IsTerminal;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, TryRecvError};
use std::time::{Duration, Instant};

use messages::{Action, Request, StrategyCode};
use program::Exit;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

use crate::failure::Failure;
use crate::image_plane::ImagePlane;
use crate::status::Status;
use crate::view::word;
use crate::watcher::Watcher;
use crate::{output, request, stop};
use palette::Palette;
use screen::{Screen, draw};

/// Time between two pictures.
const FRAME: Duration = Duration::from_millis(50);
/// Time between two looks for a changed scene.
const LOOK: Duration = Duration::from_secs(1);
/// How long to wait for an answer.
const PATIENCE: Duration = Duration::from_secs(2);

/// What a key asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Command {
    Quit,
    Ask(Action),
    ArmAfterStop,
    Strategy(StrategyCode),
}

fn command(key: &KeyEvent) -> Option<Command> {
    let control = key.modifiers.contains(KeyModifiers::CONTROL);
    Some(match key.code {
        _ if key.kind == KeyEventKind::Release => return None,
        KeyCode::Char('c') if control => Command::Quit,
        KeyCode::Char('q') | KeyCode::Esc => Command::Quit,
        KeyCode::Char('a') => Command::Ask(Action::Arm),
        KeyCode::Char('A') => Command::ArmAfterStop,
        KeyCode::Char('d') => Command::Ask(Action::Disarm),
        KeyCode::Char('s' | ' ') => Command::Ask(Action::Stop),
        KeyCode::Char('f') => Command::Ask(Action::Record),
        // The strategies are on the digits from 1, in the order of their codes from 0.
        KeyCode::Char(key) => {
            let code = key.to_digit(10)?.checked_sub(1)?;
            Command::Strategy(StrategyCode::from_code(code)?)
        }
        _ => return None,
    })
}

/// Shows the domain until `q`, Ctrl-C, SIGTERM or SIGHUP. A daemon may start, end and start again
/// meanwhile. `neighbours` are those of knn.
///
/// # Errors
/// The domain cannot be joined or watched; there is no terminal.
pub fn run(directory: &Path, plane: ImagePlane, neighbours: u32) -> Result<Exit, Failure> {
    let mut watcher = Watcher::open(directory)?;
    if !(std::io::stdout().is_terminal() && std::io::stdin().is_terminal()) {
        let message =
            "watch: standard output is no terminal; use `vpcctl status`, --json for scripts";
        return Err(Failure::new(Exit::Usage, message));
    }
    let end = program::stop_on_signals()?;
    // Restores the terminal also when we panic.
    let mut terminal = ratatui::try_init()?;
    let mut session = Session {
        status: Status::new(&watcher),
        plane,
        neighbours,
        message: String::new(),
        answer: None,
    };
    let result = session.show(&mut terminal, &mut watcher, &end);
    // The terminal may be gone.
    let _ = ratatui::try_restore();
    if let Some(answer) = session.answer {
        // A stop must reach the daemon before this process ends.
        let _ = answer.recv_timeout(PATIENCE);
    }
    result.map(|()| Exit::Ok)
}

/// Keys, from a thread of its own: crossterm 0.29 reads a terminal that is gone for ever. The
/// kernel tells us by SIGHUP.
fn keys() -> Receiver<KeyEvent> {
    let (sender, keys) = mpsc::channel();
    std::thread::spawn(move || {
        while let Ok(event) = event::read() {
            if let Event::Key(key) = event
                && sender.send(key).is_err()
            {
                return;
            }
        }
    });
    keys
}

/// What is shown.
struct Session {
    status: Status,
    plane: ImagePlane,
    neighbours: u32,
    message: String,
    answer: Option<Receiver<String>>,
}

impl Session {
    fn show(
        &mut self,
        terminal: &mut ratatui::DefaultTerminal,
        watcher: &mut Watcher,
        end: &AtomicBool,
    ) -> Result<(), Failure> {
        let palette = Palette {
            colours: output::colours(),
        };
        let (keys, mut looked) = (keys(), Instant::now());
        while !end.load(Ordering::Relaxed) {
            self.status.update(watcher)?;
            self.take_answer();
            if looked.elapsed() >= LOOK {
                self.plane.refresh();
                looked = Instant::now();
            }
            let screen = Screen {
                status: &self.status,
                plane: &self.plane,
                message: &self.message,
                palette,
            };
            terminal.draw(|frame| draw(frame, &screen))?;
            let key = match keys.recv_timeout(FRAME) {
                Ok(key) => key,
                Err(RecvTimeoutError::Timeout) => continue,
                Err(RecvTimeoutError::Disconnected) => break,
            };
            match command(&key) {
                Some(Command::Quit) => break,
                // What is on the screen was seen; a stop takes a key of its own.
                Some(Command::Ask(Action::Arm)) => {
                    let veto = self.veto();
                    let is_stop = Action::of_veto(veto) == Some(Action::Stop);
                    self.ask(request::arm(if is_stop { 0 } else { veto }));
                }
                Some(Command::ArmAfterStop) => self.ask(request::arm(self.veto())),
                Some(Command::Ask(action)) => self.ask(request::plain(action)),
                Some(Command::Strategy(strategy)) => {
                    let is_knn = strategy == StrategyCode::Knn;
                    let neighbours = if is_knn { self.neighbours } else { 0 };
                    self.ask(request::strategy(strategy, neighbours));
                }
                None => (),
            }
        }
        Ok(())
    }

    /// The veto that the screen shows; 0: none.
    fn veto(&self) -> u32 {
        self.status.view.latest().map_or(0, |last| last.veto)
    }

    /// Sends a request from a thread of its own, so that the picture goes on; its answer replaces
    /// that of an earlier one.
    fn ask(&mut self, request: Request) {
        let action = word(request.action());
        self.message = format!("{action}: asked");
        let (sender, answer) = mpsc::channel();
        let directory = self.status.directory.clone();
        std::thread::spawn(move || {
            let answer = match request.action() {
                Some(Action::Stop) => stop::stop(&directory, PATIENCE),
                _ => request::ask(&directory, &request, PATIENCE),
            };
            let line = match answer {
                Ok((line, _)) => line,
                Err(failure) => format!("{action}: {failure}"),
            };
            // A newer request may have been made.
            let _ = sender.send(line);
        });
        self.answer = Some(answer);
    }

    fn take_answer(&mut self) {
        match self.answer.as_ref().map(Receiver::try_recv) {
            Some(Ok(text)) => {
                // The second line is for a shell.
                let mut lines = text.lines();
                self.message = lines.next().unwrap_or_default().to_owned();
                if lines.next().is_some() {
                    self.message += "; A arms all the same";
                }
            }
            Some(Err(TryRecvError::Empty)) | None => return,
            Some(Err(TryRecvError::Disconnected)) => (),
        }
        self.answer = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn space_and_s_stop_and_letters_do_what_the_last_line_says() {
        let press = |code| command(&KeyEvent::new(code, KeyModifiers::NONE));
        for code in [KeyCode::Char('s'), KeyCode::Char(' ')] {
            assert_eq!(press(code), Some(Command::Ask(Action::Stop)));
        }
        assert_eq!(press(KeyCode::Char('a')), Some(Command::Ask(Action::Arm)));
        assert_eq!(press(KeyCode::Char('A')), Some(Command::ArmAfterStop));
        assert_eq!(
            press(KeyCode::Char('d')),
            Some(Command::Ask(Action::Disarm))
        );
        assert_eq!(
            press(KeyCode::Char('3')),
            Some(Command::Strategy(StrategyCode::Gpr))
        );
        assert_eq!(press(KeyCode::Char('x')), None);
        let interrupt = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
        assert_eq!(command(&interrupt), Some(Command::Quit));
    }
}
