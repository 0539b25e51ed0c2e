//! Borders of a mask as polygons, for panels that draw lines. Units: px.

use std::collections::BTreeMap;

use scene::Mask;

/// Farthest that a border may be from its pixels' edges, px: the steps of a slanted border become a line.
const TOLERANCE: f64 = 1.0;

/// A corner of pixels: column and row of the pixel to its lower right.
type Corner = [usize; 2];

/// Directions of a walk, each the former turned right (v points down).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    Right,
    Down,
    Left,
    Up,
}

impl Way {
    fn turned(self, quarters: usize) -> Self {
        const ALL: [Way; 4] = [Way::Right, Way::Down, Way::Left, Way::Up];
        ALL[(self as usize + quarters) % 4]
    }

    fn from(self, [u, v]: Corner) -> Corner {
        match self {
            Self::Right => [u + 1, v],
            Self::Down => [u, v + 1],
            Self::Left => [u - 1, v],
            Self::Up => [u, v - 1],
        }
    }
}

/// The closed borders of the forbidden pixels, holes included.
pub(crate) fn outlines(mask: &Mask) -> Vec<Vec<[f64; 2]>> {
    let mut edges = edges(mask);
    let mut outlines = Vec::new();
    while let Some((&start, ways)) = edges.first_key_value() {
        let Some(&first) = ways.first() else {
            edges.pop_first();
            continue;
        };
        let (mut at, mut way, mut corners) = (start, first, Vec::new());
        // Where two pixels meet at a corner only, the turn to the right stays with the one that is walked round. No walk
        // begins there: one of the two lies to the left, and has edges that come first.
        while let Some(next) = take(&mut edges, at, way) {
            if corners.is_empty() || next != way {
                // A pixel is the square about its whole-numbered centre.
                corners.push(at.map(|x| x as f64 - 0.5));
            }
            way = next;
            at = way.from(at);
        }
        outlines.push(simplified(&corners));
    }
    outlines
}

/// The edges between forbidden and free pixels, by the corner from which they are walked: forbidden pixels to the right.
fn edges(mask: &Mask) -> BTreeMap<Corner, Vec<Way>> {
    let mut edges: BTreeMap<Corner, Vec<Way>> = BTreeMap::new();
    let is_free = |column: Option<usize>, row: Option<usize>| match (column, row) {
        (Some(column), Some(row)) => !mask.is_forbidden(column, row),
        _ => true,
    };
    for row in 0..mask.height() {
        for column in (0..mask.width()).filter(|column| mask.is_forbidden(*column, row)) {
            let (left, above) = (column.checked_sub(1), row.checked_sub(1));
            for (neighbour, corner, way) in [
                ((Some(column), above), [column, row], Way::Right),
                ((Some(column + 1), Some(row)), [column + 1, row], Way::Down),
                (
                    (Some(column), Some(row + 1)),
                    [column + 1, row + 1],
                    Way::Left,
                ),
                ((left, Some(row)), [column, row + 1], Way::Up),
            ] {
                if is_free(neighbour.0, neighbour.1) {
                    edges.entry(corner).or_default().push(way);
                }
            }
        }
    }
    edges
}

/// Takes the edge on which a walk goes on, the rightmost: `None` where all are walked.
fn take(edges: &mut BTreeMap<Corner, Vec<Way>>, at: Corner, way: Way) -> Option<Way> {
    let ways = edges.get_mut(&at)?;
    let right_first = [1, 0, 3].map(|quarters| way.turned(quarters));
    let place = right_first
        .iter()
        .find_map(|wanted| ways.iter().position(|way| way == wanted))?;
    let next = ways.swap_remove(place);
    if ways.is_empty() {
        edges.remove(&at);
    }
    Some(next)
}

/// A polygon of fewer corners, none of the former farther than the tolerance from it (Douglas and Peucker's way).
fn simplified(corners: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let Some(first) = corners.first() else {
        return Vec::new();
    };
    let far = |from: &[f64; 2], to: &[f64; 2]| (from[0] - to[0]).hypot(from[1] - to[1]);
    let turn = (0..corners.len())
        .max_by(|&a, &b| far(first, &corners[a]).total_cmp(&far(first, &corners[b])))
        .unwrap_or(0);
    let mut closed = corners.to_vec();
    closed.push(*first);
    let mut keep = vec![false; closed.len()];
    (keep[0], keep[turn]) = (true, true);
    let mut open = vec![(0, turn), (turn, closed.len() - 1)];
    while let Some((from, to)) = open.pop() {
        let worst = (from + 1..to)
            .map(|i| (distance(closed[i], closed[from], closed[to]), i))
            .max_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((_, i)) = worst.filter(|(off, _)| *off > TOLERANCE) {
            keep[i] = true;
            open.extend([(from, i), (i, to)]);
        }
    }
    let kept = closed.iter().zip(keep).filter(|(_, keep)| *keep);
    kept.map(|(corner, _)| *corner).collect()
}

/// Distance of a point from a segment.
fn distance(point: [f64; 2], from: [f64; 2], to: [f64; 2]) -> f64 {
    let along = [to[0] - from[0], to[1] - from[1]];
    let off = [point[0] - from[0], point[1] - from[1]];
    let square = along[0] * along[0] + along[1] * along[1];
    let part = match square > 0.0 {
        true => ((off[0] * along[0] + off[1] * along[1]) / square).clamp(0.0, 1.0),
        false => 0.0,
    };
    (off[0] - part * along[0]).hypot(off[1] - part * along[1])
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use scene::Scene;

    /// The paper's simulated scene with a painted mask instead of its occlusions; and the mask's file.
    pub(crate) fn painted(is_white: impl Fn(u32, u32) -> bool) -> (Scene, Vec<u8>) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("mask.png");
        scene::write_mask(&path, 1024, 1024, is_white).unwrap();
        let (head, _) = scene::PAPER_SIM.split_once("[[occlusion]]").unwrap();
        let text = format!("{head}[[occlusion]]\nname = \"painted\"\nmask = \"mask.png\"\n");
        let png = std::fs::read(path).unwrap();
        let scene = Scene::parse_with(&text, "painted.toml", &|_| Ok(png.clone())).unwrap();
        (scene, png)
    }

    fn of(is_white: impl Fn(u32, u32) -> bool) -> Vec<Vec<[f64; 2]>> {
        outlines(painted(is_white).0.masks().next().unwrap())
    }

    /// Twice the area that a loop encloses, positive where it is walked with its inside to the right.
    fn area(outline: &[[f64; 2]]) -> f64 {
        let pairs = outline.iter().zip(outline.iter().cycle().skip(1));
        pairs.map(|([a, b], [c, d])| a * d - c * b).sum::<f64>() / 2.0
    }

    #[test]
    fn a_rectangle_has_its_four_corners_even_at_the_edge_of_the_image() {
        let boxes =
            of(|i, j| (100..200).contains(&i) && (300..420).contains(&j) || (i >= 1000 && j < 50));
        let corner = vec![[999.5, -0.5], [1023.5, -0.5], [1023.5, 49.5], [999.5, 49.5]];
        assert_eq!(boxes.len(), 2);
        assert!(boxes.iter().any(|outline| {
            let mut sorted = outline.clone();
            let mut expected = corner.clone();
            sorted.sort_by(|a, b| a.partial_cmp(b).unwrap());
            expected.sort_by(|a, b| a.partial_cmp(b).unwrap());
            sorted == expected
        }));
        let areas: f64 = boxes.iter().map(|outline| area(outline)).sum();
        assert_eq!(areas, 100.0 * 120.0 + 24.0 * 50.0);
    }

    #[test]
    fn a_ring_has_an_outer_and_an_inner_border_of_few_corners() {
        let radius = |i: u32, j: u32| f64::hypot(i as f64 - 511.5, j as f64 - 511.5);
        let ring = of(|i, j| (100.0..200.0).contains(&radius(i, j)));
        let mut areas: Vec<f64> = ring.iter().map(|outline| area(outline)).collect();
        areas.sort_by(f64::total_cmp);
        let disc = |radius: f64| std::f64::consts::PI * radius * radius;
        assert_eq!(ring.len(), 2, "{areas:?}");
        assert!((areas[0] / disc(100.0) + 1.0).abs() < 0.02, "{areas:?}");
        assert!((areas[1] / disc(200.0) - 1.0).abs() < 0.02, "{areas:?}");
        assert!(
            ring.iter()
                .all(|outline| (20..200).contains(&outline.len()))
        );
    }

    #[test]
    fn pixels_that_meet_at_a_corner_have_borders_of_their_own() {
        let two = of(|i, j| {
            let (low, high) = (100..140, 140..180);
            (low.contains(&i) && low.contains(&j)) || (high.contains(&i) && high.contains(&j))
        });
        assert_eq!(two.len(), 2);
        assert!(two.iter().all(|outline| area(outline) == 1600.0));
    }
}
