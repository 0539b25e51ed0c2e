//! Columns of a printed table.

use hw_sim::following::FollowingReport;

/// One column: its title, and its cell in a row.
#[derive(Debug)]
pub struct Column<Row> {
    title: &'static str,
    shown: Shown<Row>,
    cell: fn(&Row) -> String,
}

/// Whether a row, in a table that is wide or not, shows a column.
pub type Shown<Row> = fn(bool, &Row) -> bool;

impl<Row> Column<Row> {
    /// A column that is always printed: all of these together fit into 100 characters.
    pub const fn always(title: &'static str, cell: fn(&Row) -> String) -> Self {
        Self {
            title,
            shown: |_, _| true,
            cell,
        }
    }

    /// A column that only `--wide` prints.
    pub const fn wide(title: &'static str, cell: fn(&Row) -> String) -> Self {
        Self {
            shown: |is_wide, _| is_wide,
            ..Self::always(title, cell)
        }
    }

    /// A column that is printed where a row shows it.
    pub const fn when(title: &'static str, shown: Shown<Row>, cell: fn(&Row) -> String) -> Self {
        Self { title, shown, cell }
    }
}

/// Rows as a Markdown table whose columns line up: the first to the left, the others to the right.
pub fn markdown<Row>(columns: &[Column<Row>], rows: &[Row], is_wide: bool) -> String {
    let is_shown = |column: &&Column<Row>| rows.iter().any(|row| (column.shown)(is_wide, row));
    let columns: Vec<_> = columns.iter().filter(is_shown).collect();
    let titles = columns.iter().map(|column| column.title.to_owned());
    let mut lines: Vec<Vec<String>> = vec![titles.collect()];
    lines.extend(
        rows.iter()
            .map(|row| columns.iter().map(|column| (column.cell)(row)).collect()),
    );
    let widths = (0..columns.len()).map(|k| {
        let cells = lines.iter().map(|line| line[k].chars().count());
        cells.max().unwrap_or(0)
    });
    let widths: Vec<usize> = widths.collect();
    let mut text = String::new();
    for (number, line) in lines.iter().enumerate() {
        for (k, (cell, &width)) in line.iter().zip(&widths).enumerate() {
            text += &match k {
                0 => format!("| {cell:<width$} |"),
                _ => format!(" {cell:>width$} |"),
            };
        }
        text += "\n";
        if number == 0 {
            for (k, &width) in widths.iter().enumerate() {
                text += &match k {
                    0 => format!("|{}|", "-".repeat(width + 2)),
                    _ => format!("{}:|", "-".repeat(width + 1)),
                };
            }
            text += "\n";
        }
    }
    text
}

/// A time in tenths of a second; `-` where there is none.
pub fn seconds(time_s: Option<f64>) -> String {
    time_s.map_or("-".to_owned(), |s| format!("{s:.1}"))
}

/// RMS and largest feature error of a camera that follows, px; `-` where none arrived.
pub fn followed_px(report: Option<&FollowingReport>) -> String {
    let figures = |it: &FollowingReport| format!("{:.2}, {:.1}", it.rms_px, it.worst_px);
    report.map_or("-".to_owned(), figures)
}

/// RMS distances of a camera that follows, and of the object in its view, from their places, mm;
/// `-` where none arrived.
pub fn followed_mm(report: Option<&FollowingReport>) -> String {
    let figures = |it: &FollowingReport| format!("{:.2}, {:.2}", it.rms_mm, it.rms_object_mm);
    report.map_or("-".to_owned(), figures)
}

/// RMS change of its command from frame to frame as a share of the limit; `-` where none arrived.
pub fn followed_change(report: Option<&FollowingReport>) -> String {
    let change = |it: &FollowingReport| format!("{:.2} %", 100.0 * it.change);
    report.map_or("-".to_owned(), change)
}

/// How many runs failed for which reason, without the reasons that none failed for.
pub fn failures(counts: &[(usize, &str)]) -> String {
    let there = counts.iter().filter(|(count, _)| *count > 0);
    let words = there.map(|(count, noun)| match count {
        1 => format!("1 {noun}"),
        count => format!("{count} {noun}s"),
    });
    let words: Vec<String> = words.collect();
    match words.is_empty() {
        true => "none".to_owned(),
        false => words.join(", "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_line_up_and_wide_ones_are_printed_on_request() {
        let columns: [Column<(&str, f64)>; 3] = [
            Column::always("strategy", |row| row.0.to_owned()),
            Column::wide("interval", |_| "89 to 93".to_owned()),
            Column::always("cost", |row| format!("{:.1}", row.1)),
        ];
        let rows = [("gpr:3", 30.6), ("foresight:3", 110.7)];
        let narrow = "\
| strategy    |  cost |
|-------------|------:|
| gpr:3       |  30.6 |
| foresight:3 | 110.7 |
";
        assert_eq!(markdown(&columns, &rows, false), narrow);
        assert!(markdown(&columns, &rows, true).contains("| gpr:3       | 89 to 93 |  30.6 |\n"));
    }

    #[test]
    fn failures_are_counted_by_their_reason() {
        let all = [(2, "violation"), (0, "timeout"), (1, "fault")];
        assert_eq!(failures(&all), "2 violations, 1 fault");
        assert_eq!(failures(&[(0, "timeout")]), "none");
    }
}
