//! Errors of a laboratory, one by one and at any level: changes to the configurations of `hw-sim`,
//! which it has, and of `vpc-camera`, which is told something else.

use std::path::Path;

use anyhow::{Context, bail};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Deserialize;
use toml::{Table, Value};

/// One error, at level 1.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Flaw {
    /// One or two words.
    pub name: String,
    /// What it is at level 1, with units.
    pub what: String,
    /// Whether it may be of either sign: then each laboratory draws the signs of its numbers.
    #[serde(default)]
    pub signed: bool,
    /// Keys of `hw-sim.toml`.
    pub keys: Table,
    /// Keys of a calibration file of `vpc-camera`: what the user found out about it.
    #[serde(default)]
    pub told: Table,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    flaw: Vec<Flaw>,
}

/// The errors of a file.
///
/// # Errors
/// The file cannot be read or has other keys.
pub fn read(path: &Path) -> anyhow::Result<Vec<Flaw>> {
    let name = || path.display().to_string();
    let text = std::fs::read_to_string(path).with_context(name)?;
    let file: File = toml::from_str(&text).with_context(name)?;
    Ok(file.flaw)
}

impl Flaw {
    /// Adds this error to the configurations, `level` times as large, in laboratory number
    /// `laboratory`.
    ///
    /// # Errors
    /// A key has a value that is no number, or another type than the one that it goes over.
    pub fn add(
        &self,
        level: f64,
        laboratory: u64,
        keys: &mut Table,
        told: &mut Table,
    ) -> anyhow::Result<()> {
        // What is told has the signs of what is true.
        for (changes, base) in [(&self.keys, keys), (&self.told, told)] {
            let mut signs = ChaCha8Rng::seed_from_u64(laboratory);
            let mut scale = || match self.signed && signs.random::<bool>() {
                true => -level,
                false => level,
            };
            lay_over(base, changes, &mut scale)
                .with_context(|| format!("flaw \"{}\"", self.name))?;
        }
        Ok(())
    }
}

/// Lays the scaled numbers of `changes` over `base`.
fn lay_over(
    base: &mut Table,
    changes: &Table,
    scale: &mut impl FnMut() -> f64,
) -> anyhow::Result<()> {
    for (key, change) in changes {
        let change = match (base.get_mut(key), change) {
            (Some(Value::Table(base)), Value::Table(change)) => {
                lay_over(base, change, scale)?;
                continue;
            }
            (None, Value::Table(change)) => {
                let mut inner = Table::new();
                lay_over(&mut inner, change, scale)?;
                Value::Table(inner)
            }
            (_, change) => scaled(change, scale).with_context(|| key.clone())?,
        };
        base.insert(key.clone(), change);
    }
    Ok(())
}

fn scaled(value: &Value, scale: &mut impl FnMut() -> f64) -> anyhow::Result<Value> {
    Ok(match value {
        Value::Float(x) => Value::Float(x * scale()),
        Value::Integer(x) => Value::Integer((*x as f64 * scale()).round() as i64),
        Value::Array(all) => {
            let all = all.iter().map(|x| scaled(x, scale));
            Value::Array(all.collect::<anyhow::Result<_>>()?)
        }
        Value::Boolean(is_on) => Value::Boolean(*is_on && scale() != 0.0),
        other => bail!("{other}; allowed: numbers, lists of numbers, and true"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flaw(text: &str) -> Flaw {
        toml::from_str(text).unwrap()
    }

    #[test]
    fn numbers_are_scaled_in_their_tables_and_others_stay() {
        let flaw = flaw(
            "name = 'a'\nwhat = 'b'\nkeys = { drop = 0.01, truth = { center_px = [1.0, -2.0] } }\ntold = { k = 3 }",
        );
        let mut keys: Table = toml::from_str("rate = 1\ntruth = { focal = 0.5 }").unwrap();
        let mut told = Table::new();
        flaw.add(2.0, 7, &mut keys, &mut told).unwrap();
        let expected = "rate = 1\ndrop = 0.02\ntruth = { focal = 0.5, center_px = [2.0, -4.0] }";
        assert_eq!(keys, toml::from_str::<Table>(expected).unwrap());
        assert_eq!(told, toml::from_str::<Table>("k = 6").unwrap());
    }

    #[test]
    fn a_switch_is_on_at_every_level_but_zero() {
        let flaw = flaw("name = 'a'\nwhat = 'b'\nkeys = { truth = { demosaic = true } }");
        for (level, is_on) in [(0.0, false), (0.5, true), (3.0, true)] {
            let mut keys = Table::new();
            flaw.add(level, 0, &mut keys, &mut Table::new()).unwrap();
            assert_eq!(keys["truth"]["demosaic"].as_bool(), Some(is_on));
        }
    }

    #[test]
    fn each_laboratory_has_its_signs_which_are_also_told() {
        let flaw = flaw(
            "name = 'a'\nwhat = 'b'\nsigned = true\nkeys = { x = [1.0, 1.0, 1.0, 1.0] }\ntold = { x = [1.0, 1.0, 1.0, 1.0] }",
        );
        let of = |laboratory| {
            let (mut keys, mut told) = (Table::new(), Table::new());
            flaw.add(1.0, laboratory, &mut keys, &mut told).unwrap();
            assert_eq!(keys, told);
            keys
        };
        let all: Vec<Table> = (0..8).map(of).collect();
        assert!(all.iter().any(|keys| *keys != all[0]));
        assert_eq!(of(3), all[3]);
    }

    #[test]
    fn what_is_no_number_is_refused_with_flaw_and_key() {
        let flaw = flaw("name = 'odd'\nwhat = 'b'\nkeys = { camera = 'x' }");
        let error = flaw.add(1.0, 0, &mut Table::new(), &mut Table::new());
        let error = format!("{:#}", error.unwrap_err());
        assert!(error.contains("odd") && error.contains("camera"), "{error}");
    }
}
