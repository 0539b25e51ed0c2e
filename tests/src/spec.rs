//! What to run: a strategy and its prediction window.

use std::fmt;
use std::str::FromStr;

use vpc::{MAX_NP, Settings, Strategy};

/// A strategy with its preview window, written `gpr:3`; the window defaults to the paper's 3 steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Spec {
    /// The strategy.
    pub strategy: Strategy,
    /// Steps previewed.
    pub np: usize,
}

impl Spec {
    /// The settings of the law: the paper's on-line settings with this strategy and window.
    pub fn settings(&self) -> Settings {
        Settings {
            strategy: self.strategy,
            np: self.np,
            ..Settings::default()
        }
    }
}

impl fmt::Display for Spec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.strategy, self.np)
    }
}

impl FromStr for Spec {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (strategy, np) = text.trim().split_once(':').unwrap_or((text.trim(), "3"));
        let strategy = strategy
            .parse()
            .map_err(|e| format!("strategy `{strategy}`; {e}"))?;
        match np.parse() {
            Ok(np) if (1..=MAX_NP).contains(&np) => Ok(Self { strategy, np }),
            _ => Err(format!(
                "preview window `{np}` of `{text}`; allowed: 1 to {MAX_NP}"
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spec_reads_as_it_is_written() {
        for text in ["previous:30", "knn5:3", "gpr:3", "ibvs:1"] {
            assert_eq!(text.parse::<Spec>().unwrap().to_string(), text);
        }
        assert_eq!("gpr".parse::<Spec>().unwrap().np, 3);
    }

    #[test]
    fn a_bad_spec_is_named() {
        assert!(
            "gpr:41"
                .parse::<Spec>()
                .unwrap_err()
                .contains("`41` of `gpr:41`; allowed: 1 to 40")
        );
        assert!(
            "magic:3"
                .parse::<Spec>()
                .unwrap_err()
                .contains("`magic`; allowed: previous")
        );
    }
}
