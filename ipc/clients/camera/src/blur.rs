//! The Gaussian that blurs an edge: its distribution and the integral of that.

use std::sync::LazyLock;

/// Nodes on each side of 0, and how many of them to a standard deviation.
const NODES: usize = 256;
const PER_UNIT: f64 = 64.0;

/// The distribution of the standard normal at -4 to 4, and its integral from below.
static TABLE: LazyLock<Vec<[f64; 2]>> = LazyLock::new(|| {
    let density = |z: f64| (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
    let z = |node: usize| (node as f64 - NODES as f64) / PER_UNIT;
    let mut distribution = 0.0;
    let nodes = 0..=2 * NODES;
    let rows = nodes.map(|node| {
        if node > 0 {
            // Simpson's rule.
            let ends = density(z(node - 1)) + density(z(node));
            let middle = density(z(node) - 0.5 / PER_UNIT);
            distribution += (ends + 4.0 * middle) / (6.0 * PER_UNIT);
        }
        [distribution, z(node) * distribution + density(z(node))]
    });
    rows.collect()
});

/// Share of the standard normal below `z`, right to 1e-4.
pub(crate) fn below(z: f64) -> f64 {
    read(z, 0, 1.0)
}

/// Its integral from minus infinity to `z`.
pub(crate) fn area_below(z: f64) -> f64 {
    read(z, 1, z)
}

fn read(z: f64, column: usize, far: f64) -> f64 {
    let place = z * PER_UNIT + NODES as f64;
    if place <= 0.0 {
        0.0
    } else if place >= (2 * NODES) as f64 {
        far
    } else {
        let (node, share) = (place as usize, place.fract());
        TABLE[node][column] * (1.0 - share) + TABLE[node + 1][column] * share
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_standard_deviation_holds_what_tables_say() {
        for (z, expected) in [(0.0, 0.5), (1.0, 0.841345), (-1.96, 0.024998), (9.0, 1.0)] {
            assert!((below(z) - expected).abs() < 1e-4, "{z}");
        }
        assert!((area_below(0.0) - 0.398942).abs() < 1e-4);
        assert!((area_below(1.0) - 1.083316).abs() < 1e-4);
        assert_eq!((area_below(7.0), area_below(-7.0)), (7.0, 0.0));
    }
}
