//! Colours of the terminal.

use ratatui::style::{Color, Modifier, Style};

use crate::output::Tone;

/// Colours, where they may be used.
#[derive(Clone, Copy, Debug)]
pub struct Palette {
    /// Whether they may.
    pub colours: bool,
}

impl Palette {
    /// Text of this colour.
    pub fn style(self, color: Color) -> Style {
        Style::new().fg(self.color(color))
    }

    /// The colour itself, or none.
    pub fn color(self, color: Color) -> Color {
        match self.colours {
            true => color,
            false => Color::Reset,
        }
    }

    /// Bold text in the colour of the tone.
    pub fn tone(self, tone: Tone) -> Style {
        let color = match tone {
            Tone::Good => Color::Green,
            Tone::Warning => Color::Yellow,
            Tone::Bad => Color::Red,
        };
        self.style(color).add_modifier(Modifier::BOLD)
    }
}
