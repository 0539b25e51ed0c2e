//! A scene file for a task of one's own, commented like the paper's.

use std::fmt::Write;

use scene::Camera;

/// What a user knows of a task; the rest follows from it.
#[derive(Clone, Debug, PartialEq)]
pub struct Template {
    /// The camera.
    pub camera: Camera,
    /// Points of the pattern in the object frame, m; on z = 0.
    pub pattern: Vec<[f64; 3]>,
    /// Side of a marker, m, where it is known.
    pub marker_size: Option<f64>,
    /// Translation of the object in the camera frame at the goal, m.
    pub goal: [f64; 3],
    /// Its rotation vector, rad.
    pub goal_rotation: [f64; 3],
    /// Limit of each linear component of the camera velocity, m/s.
    pub linear: f64,
    /// Limit of each angular component, rad/s.
    pub angular: f64,
    /// Nearest and furthest depth of starts, m.
    pub depth: [f64; 2],
    /// Greatest tilt of starts about the image axes, rad.
    pub tilt: f64,
    /// Greatest roll of starts about the optical axis, rad.
    pub roll: f64,
    /// Path of a mask, as the scene file names it.
    pub mask: Option<String>,
    /// Centre and half sizes of ellipses, px.
    pub ellipses: Vec<[f64; 4]>,
    /// Centre and half sizes of near rectangles, px.
    pub boxes: Vec<[f64; 4]>,
}

/// The paper's proportions: clearance, start distance, tolerated violation and arrival, shares of
/// the image width.
const CLEARANCE: f64 = 0.02;
const MIN_ERROR: f64 = 0.12;
const VIOLATION: f64 = 0.015;
const ARRIVED: f64 = 0.002;
/// How far starts lie beside the goal, times the distance from the optical axis to the image border
/// at its depth.
const BESIDE: f64 = 1.3;
/// Time allowed, times that of moving by the goal's depth at the linear limit.
const TIME: f64 = 12.0;

impl Template {
    /// The corners of a rectangle about the object's origin, m, in the order in which features are
    /// stacked.
    pub fn rectangle(width: f64, height: f64) -> Vec<[f64; 3]> {
        let (x, y) = (0.5 * width, 0.5 * height);
        vec![[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]]
    }

    /// The text of the scene file.
    pub fn text(&self) -> String {
        let [width, height, fx, fy, cx, cy, rate_hz] = self.camera.numbers();
        let [x, y, z] = self.goal;
        let side = [
            BESIDE * z * 0.5 * width / fx,
            BESIDE * z * 0.5 * height / fy,
        ];
        let points: Vec<String> = self.pattern.iter().map(list).collect();
        let time = (TIME * z / self.linear - 1e-9).max(15.0).ceil();
        let about = "side of a marker, a tag with its white border, m; 0: points";
        let marker_size = match self.marker_size {
            Some(size) => format!("marker_size = {size:?}  # {about}\n"),
            None => format!("# marker_size = 0.03  # {about}\n"),
        };
        let mut text = format!(
            "# Written by `vpc-memory new`: every value may be edited. Units: px, m, s, rad. Poses are of the object in\n\
             # the camera frame (u and x to the right, v and y down, z forward): translation and rotation vector.\n\n\
             [camera]\nwidth = {width}\nheight = {height}\nfx = {fx:?}\nfy = {fy:?}\ncx = {cx:?}\ncy = {cy:?}\n\
             rate_hz = {rate_hz:?}\n\n\
             [pattern]\n# points in the object frame, in the order in which the features are stacked; all on z = 0\n\
             points = [{}]\n{marker_size}\n\
             [goal]\ntranslation = {}\nrotation = {}\n\n\
             [limits]\nlinear = {:?}   # m/s, each component of the camera velocity\n\
             angular = {:?}  # rad/s\n\
             # linear_acceleration = 1.0   # m/s^2, without it any: most change of a component in a second\n\
             # angular_acceleration = 2.0  # rad/s^2\n\n\
             [cost]\n# the paper's weights: of the squared image error (1/px^2), of the squared velocity\n\
             k_q = 1e-3\nr = [100.0, 100.0, 1.0, 0.5, 0.5, 0.5]\n\n\
             [success]\n\
             violation_px = {:?}    # a point deeper than this in an occlusion or outside the image: a failure\n\
             convergence_px = {:?}  # largest component of s - s* that counts as arrived\n\
             time_s = {time:?}\n\n\
             [starts]\n\
             # what a random start is drawn from; a draw is kept where every point is at least `clearance_px` inside\n\
             # the image and outside the occlusions and the mean |s - s*| is at least `min_error_px`\n\
             translation_min = {}\ntranslation_max = {}\n\
             tilt_max = {:?}  # rad, each of the rotation vector's x and y, applied first\n\
             roll_max = {:?}  # rad about the optical axis, applied second\n\
             clearance_px = {:?}\nmin_error_px = {:?}\n",
            points.join(", "),
            list(&self.goal),
            list(&self.goal_rotation),
            self.linear,
            self.angular,
            tenth(VIOLATION * width),
            tenth(ARRIVED * width).max(1.0),
            list(&[milli(x - side[0]), milli(y - side[1]), self.depth[0]]),
            list(&[milli(x + side[0]), milli(y + side[1]), self.depth[1]]),
            self.tilt,
            self.roll,
            tenth(CLEARANCE * width),
            tenth(MIN_ERROR * width),
        );
        if let Some(mask) = &self.mask {
            let mask = toml::Value::from(mask.as_str());
            let _ = write!(
                text,
                "\n# White pixels are forbidden, black ones free; the image is as large as the camera's.\n\
                 [[occlusion]]\nname = \"mask\"\nmask = {mask}\n"
            );
        }
        if !self.ellipses.is_empty() || !self.boxes.is_empty() {
            text += "\n# A part with centre c, half sizes h and exponent p covers the points with\n\
                     # (|u-c_u|/h_u)^p + (|v-c_v|/h_v)^p < 1: p = 2 an ellipse, p = 8 nearly a rectangle.\n";
        }
        for (kind, p, shapes) in [("ellipse", 2.0, &self.ellipses), ("box", 8.0, &self.boxes)] {
            for (index, [u, v, half_u, half_v]) in shapes.iter().enumerate() {
                let _ = write!(
                    text,
                    "[[occlusion]]\nname = \"{kind} {}\"\n\
                     parts = [{{ center = [{u:?}, {v:?}], half = [{half_u:?}, {half_v:?}], p = {p:?} }}]\n",
                    index + 1
                );
            }
        }
        text
    }
}

/// Numbers as TOML writes floats.
fn list(numbers: &[f64; 3]) -> String {
    let [x, y, z] = numbers;
    format!("[{x:?}, {y:?}, {z:?}]")
}

fn tenth(x: f64) -> f64 {
    (10.0 * x).round() / 10.0
}

fn milli(x: f64) -> f64 {
    (1000.0 * x).round() / 1000.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::Scene;

    fn template() -> Template {
        Template {
            camera: Camera {
                width: 640.0,
                height: 480.0,
                fx: 610.5,
                fy: 611.0,
                cx: 318.0,
                cy: 242.25,
                rate_hz: 30.0,
            },
            pattern: Template::rectangle(0.1, 0.06),
            marker_size: Some(0.01),
            goal: [0.02, 0.0, 0.4],
            goal_rotation: [0.0, 0.1, 0.0],
            linear: 0.2,
            angular: 0.5,
            depth: [0.3, 0.9],
            tilt: 0.3,
            roll: 1.0,
            mask: None,
            ellipses: vec![[100.0, 90.0, 40.0, 30.0]],
            boxes: vec![[500.0, 60.0, 60.0, 20.0], [90.0, 400.0, 30.0, 30.0]],
        }
    }

    #[test]
    fn what_is_written_is_read_back() {
        let template = template();
        let scene = Scene::parse(&template.text(), "new").unwrap();
        assert_eq!(scene.camera, template.camera);
        assert_eq!(scene.pattern.to_vec(), template.pattern);
        assert_eq!((scene.marker_size, scene.has_marker_size), (0.01, true));
        assert_eq!(scene.goal.translation, template.goal);
        assert_eq!(scene.goal.rotation, template.goal_rotation);
        assert_eq!((scene.limits.linear, scene.limits.angular), (0.2, 0.5));
        assert_eq!(scene.starts.translation_min[2], 0.3);
        let parts: Vec<f64> = scene.parts().map(|part| part.p).collect();
        assert_eq!(parts, [2.0, 8.0, 8.0]);
        assert_eq!(scene.success.time_s, 24.0);
    }

    #[test]
    fn the_papers_task_gets_nearly_the_papers_scene() {
        let paper = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let template = Template {
            camera: paper.camera,
            pattern: paper.pattern.to_vec(),
            marker_size: None,
            goal: paper.goal.translation,
            goal_rotation: paper.goal.rotation,
            linear: 0.5,
            angular: 1.0,
            depth: [0.45, 1.3],
            tilt: 0.5,
            roll: 1.5,
            ellipses: vec![],
            boxes: vec![],
            mask: None,
        };
        let scene = Scene::parse(&template.text(), "new").unwrap();
        assert_eq!(scene.cost, paper.cost);
        assert!(!scene.has_marker_size);
        assert!((scene.starts.translation_max[0] - 0.5).abs() < 0.01);
        assert!((scene.starts.clearance_px / paper.starts.clearance_px - 1.0).abs() < 0.05);
        assert!((scene.starts.min_error_px / paper.starts.min_error_px - 1.0).abs() < 0.05);
        assert!((scene.success.violation_px / paper.success.violation_px - 1.0).abs() < 0.05);
        assert_eq!(scene.success.time_s, 15.0);
    }
}
