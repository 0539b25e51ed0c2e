//! A measured table as a file of the repository, `tests/results/table.json`, which `cargo table
//! --results` writes and README.md quotes.

use anyhow::Context;
use serde::{Deserialize, Serialize};

use crate::row::Row;

/// The file that README.md quotes, from the root of the repository.
pub const FILE: &str = "tests/results/table.json";

/// Table I of the paper: success, cost and cycle of a strategy with its steps ahead.
///
/// Source: A. Paolillo, T. S. Lembono, S. Calinon, ICRA 2020.
const PAPER: [(&str, usize, &str); 4] = [
    ("previous", 3, "80 %, 49.3, 85 ms"),
    ("previous", 30, "83 %, 52.9, 550 ms"),
    ("knn", 3, "92 %, 19.6, 74 ms"),
    ("gpr", 3, "93 %, 16.4, 80 ms"),
];

/// Tables of one command.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Results {
    /// The commit that was run; with `-dirty` where files differed from it.
    pub commit: String,
    /// The command line.
    pub command: String,
    /// A table for each memory.
    pub tables: Vec<Measured>,
}

/// The table of one memory.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Measured {
    /// The memory: a file, or COUNT@SEED.
    pub memory: String,
    /// A line for each strategy or method.
    pub lines: Vec<Line>,
}

/// What a page quotes of a row.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Line {
    strategy: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    np: Option<usize>,
    success_rate: f64,
    success_interval: [f64; 2],
    mean_cost: f64,
    /// Cycles to arrival.
    steps: f64,
    /// Median and 99th percentile of a cycle, us.
    cycle_us: [f64; 2],
    #[serde(skip_serializing_if = "Option::is_none")]
    foresight: Option<Foresight>,
}

/// What a page quotes of foresight alone.
#[derive(Clone, Debug, Deserialize, Serialize)]
struct Foresight {
    /// Median and 99th percentile of what it thinks after a cycle, us.
    slack_us: [f64; 2],
    /// Mean time to standstill at the goal, s.
    standstill_s: f64,
}

impl From<&Row> for Line {
    fn from(row: &Row) -> Self {
        let foresight = Foresight {
            slack_us: [row.slack_us.p50, row.slack_us.p99],
            standstill_s: row.standstill_s,
        };
        Self {
            strategy: row.strategy.clone(),
            np: row.np.filter(|_| row.strategy != "ibvs"),
            success_rate: row.success_rate,
            success_interval: row.success_interval,
            mean_cost: row.mean_cost,
            steps: row.steps,
            cycle_us: [row.cycle_us.p50, row.cycle_us.p99],
            foresight: (row.strategy == "foresight").then_some(foresight),
        }
    }
}

impl Results {
    /// No table yet, of a command that begins at the commit that is checked out.
    pub fn begin(command: String) -> Self {
        let mut git = testkit::command("git");
        git.args(["describe", "--always", "--dirty", "--exclude=*"]);
        let said = git.current_dir(crate::root()).output();
        let said = said.ok().filter(|said| said.status.success());
        let commit = said.and_then(|said| String::from_utf8(said.stdout).ok());
        Self {
            commit: commit.map_or("unknown".to_owned(), |text| text.trim().to_owned()),
            command,
            tables: Vec::new(),
        }
    }

    /// The text of the file.
    ///
    /// # Errors
    /// None that a row can cause.
    pub fn to_json(&self) -> serde_json::Result<Vec<u8>> {
        let mut text = serde_json::to_vec_pretty(self)?;
        text.push(b'\n');
        Ok(text)
    }

    /// Reads the file that README.md quotes.
    ///
    /// # Errors
    /// It is missing, or no such file.
    pub fn read() -> anyhow::Result<Self> {
        let path = crate::root().join(FILE);
        let read = || anyhow::Ok(serde_json::from_slice(&std::fs::read(&path)?)?);
        read().with_context(|| path.display().to_string())
    }

    /// README.md with this table in the place of the one between its markers.
    ///
    /// # Errors
    /// The markers or the rows are not there.
    pub fn quoted(&self, page: &str) -> anyhow::Result<String> {
        const BEGIN: &str = "<!-- begin table -->\n";
        const END: &str = "<!-- end table -->";
        let (head, rest) = page.split_once(BEGIN).context("no `begin table`")?;
        let (_, tail) = rest.split_once(END).context("no `end table`")?;
        Ok(format!("{head}{BEGIN}{}{END}{tail}", self.markdown()?))
    }

    /// All lines of the first table, of the others what foresight makes of their memory, and what
    /// the figures mean.
    fn markdown(&self) -> anyhow::Result<String> {
        let (first, others) = self.tables.split_first().context("no table")?;
        let others = others.iter().flat_map(|table| &table.lines);
        let others = others.filter(|line| line.foresight.is_some());
        let mut text = "\
| strategy | steps ahead (Np) | success (95 %) | mean cost | cycles to arrival | cycle p50 / p99 | the paper: success, cost, cycle |
|---|--:|--:|--:|--:|--:|--:|
"
        .to_owned();
        (first.lines.iter()).for_each(|line| text += &line.markdown(""));
        others.for_each(|line| text += &line.markdown(", shipped memory"));
        let foresight = first.lines.iter().find_map(|line| line.foresight.as_ref());
        let Foresight {
            slack_us,
            standstill_s,
        } = foresight.context("no line of foresight")?;
        text += &format!(
            "
Measured at {} by `{}`.

- Between two commands, and before a run's first, foresight thinks for another {} (median / p99).
- A run arrives, as in the paper, within the threshold, at any speed. With foresight the camera rests after {standstill_s:.1} s.
",
            self.commit,
            self.command,
            times(slack_us),
        );
        Ok(text)
    }
}

impl Line {
    /// A line of the page's table; `memory` is said of the strategy.
    fn markdown(&self, memory: &str) -> String {
        let [low, high] = self.success_interval.map(|share| 100.0 * share);
        let is_it = |(strategy, np, _): &&(&str, usize, &str)| {
            *strategy == self.strategy && Some(*np) == self.np
        };
        format!(
            "| {}{memory} | {} | {:.0} % ({low:.0} to {high:.0}) | {:.1} | {:.0} | {} | {} |\n",
            self.strategy,
            self.np.map_or(String::new(), |np| np.to_string()),
            100.0 * self.success_rate,
            self.mean_cost,
            self.steps,
            times(&self.cycle_us),
            PAPER.iter().find(is_it).map_or("", |(.., figures)| figures),
        )
    }
}

/// Two times, given in us.
fn times([p50, p99]: &[f64; 2]) -> String {
    let time = |us: f64| match us < 1000.0 {
        true => format!("{us:.0} us"),
        false => format!("{:.0} ms", us / 1e3),
    };
    format!("{} / {}", time(*p50), time(*p99))
}

#[cfg(test)]
mod tests {
    use super::times;

    #[test]
    fn times_have_units_of_their_own() {
        assert_eq!(times(&[19.2, 8231.0]), "19 us / 8 ms");
    }
}
