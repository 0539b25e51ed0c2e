//! Shapes as pixels: a scene with parts becomes one with a mask.

use scene::Scene;
use vpc::obstacle::Obstacle;

/// Whether a pixel of the scene's image is forbidden: by its middle for parts, as it is for masks.
pub fn is_forbidden(scene: &Scene, column: u32, row: u32) -> bool {
    let middle = [f64::from(column), f64::from(row)];
    let (i, j) = (column as usize, row as usize);
    scene.parts().any(|part| Obstacle::Part(part).hides(middle))
        || scene.masks().any(|mask| mask.is_forbidden(i, j))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pixel_is_forbidden_where_its_middle_is() {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        // The spot: a circle about (850, 560) of radius 75.
        assert!(is_forbidden(&scene, 850, 560) && is_forbidden(&scene, 850 - 74, 560));
        // Its border runs through the middles of these, which are not inside.
        assert!(!is_forbidden(&scene, 850 - 75, 560) && !is_forbidden(&scene, 850 + 75, 560));
        let white = (0..1024u32)
            .flat_map(|j| (0..1024u32).map(move |i| (i, j)))
            .filter(|(i, j)| (770..930).contains(i) && (480..640).contains(j))
            .filter(|(i, j)| is_forbidden(&scene, *i, *j))
            .count() as f64;
        let area = std::f64::consts::PI * 75.0 * 75.0;
        assert!((white / area - 1.0).abs() < 2e-3, "{white}");
    }
}
