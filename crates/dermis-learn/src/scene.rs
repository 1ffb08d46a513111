//! Random scenes for training: shapes on a skin, each with a conductivity factor and a class. Pure geometry in the
//! plane of the sheet; the physics is elsewhere.

use std::f64::consts::{PI, TAU};

use rand::Rng;
use rand::rngs::StdRng;
use serde::{Deserialize, Serialize};

/// Background.
pub const BACKGROUND: u8 = 0;
/// Conductivity lowered: damaged, or a resistive inclusion.
pub const LOWERED: u8 = 1;
/// Conductivity raised: compressed, or a conductive inclusion.
pub const RAISED: u8 = 2;

/// A closed shape.
#[derive(Clone, Debug, PartialEq)]
pub enum Figure {
    /// A disc or ellipse: centre, half axes, rotation of the first half axis (radians).
    Ellipse([f64; 2], [f64; 2], f64),
    /// A polygon.
    Polygon(Vec<[f64; 2]>),
    /// All points within half the width of a polyline.
    Stroke(Vec<[f64; 2]>, f64),
}

/// A shape with its effect.
#[derive(Clone, Debug, PartialEq)]
pub struct Inclusion {
    /// The shape.
    pub figure: Figure,
    /// Conductivity factor.
    pub factor: f64,
    /// [`LOWERED`] or [`RAISED`].
    pub class: u8,
}

/// State of a skin at one time. Later inclusions cover earlier ones.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scene {
    /// Touches, cuts and objects.
    pub inclusions: Vec<Inclusion>,
}

/// Kind of scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SceneKind {
    /// A skin with touches and cuts: zero to four touches, which raise conductivity slightly, and cuts (lines, arcs,
    /// holes), which interrupt it.
    TouchesAndCuts,
    /// A tank with one to four objects of any shape, insulating or metallic.
    Objects,
    /// As `Objects`, but almost a third are thin bars that cross or meet: a cross, a T or a star.
    ObjectsAndCrosses,
}

impl Figure {
    /// Minimum and maximum coordinates of a bounding box.
    pub fn bounds(&self) -> ([f64; 2], [f64; 2]) {
        let around = |points: &[[f64; 2]], margin: f64| {
            let fold = |axis: usize, start: f64, choose: fn(f64, f64) -> f64| {
                points.iter().map(|p| p[axis]).fold(start, choose)
            };
            let low = [0, 1].map(|axis| fold(axis, f64::INFINITY, f64::min) - margin);
            let high = [0, 1].map(|axis| fold(axis, f64::NEG_INFINITY, f64::max) + margin);
            (low, high)
        };
        match self {
            Figure::Ellipse(middle, half, _) => around(&[*middle], half[0].max(half[1])),
            Figure::Polygon(corners) => around(corners, 0.0),
            Figure::Stroke(chain, width) => around(chain, 0.5 * width),
        }
    }

    /// True if a point is inside.
    pub fn contains(&self, p: [f64; 2]) -> bool {
        match self {
            Figure::Ellipse(middle, half, turn) => {
                let (sin, cos) = turn.sin_cos();
                let (x, y) = (p[0] - middle[0], p[1] - middle[1]);
                let (u, v) = ((cos * x + sin * y) / half[0], (cos * y - sin * x) / half[1]);
                u * u + v * v <= 1.0
            }
            Figure::Polygon(corners) => {
                let mut inside = false;
                for (k, a) in corners.iter().enumerate() {
                    let b = corners[(k + 1) % corners.len()];
                    if (a[1] > p[1]) != (b[1] > p[1]) && p[0] < a[0] + (p[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0]) {
                        inside = !inside;
                    }
                }
                inside
            }
            Figure::Stroke(chain, width) => {
                chain.windows(2).any(|ends| from_segment(p, ends[0], ends[1]) <= 0.5 * width)
            }
        }
    }
}

impl Figure {
    /// Depth of a point inside the shape, metres; negative outside. First-order approximation at the rim of an
    /// ellipse.
    pub fn depth_m(&self, p: [f64; 2]) -> f64 {
        match self {
            Figure::Ellipse(middle, half, turn) => {
                let (sin, cos) = turn.sin_cos();
                let (x, y) = (p[0] - middle[0], p[1] - middle[1]);
                let (u, v) = ((cos * x + sin * y) / half[0], (cos * y - sin * x) / half[1]);
                let level = u.hypot(v);
                // First-order distance: (1 - level) divided by the length of the gradient of level.
                let gradient = (u / half[0]).hypot(v / half[1]) / level.max(f64::MIN_POSITIVE);
                if level < 1e-9 { half[0].min(half[1]) } else { (1.0 - level) / gradient }
            }
            Figure::Polygon(corners) => {
                let sides = corners.iter().zip(corners.iter().cycle().skip(1));
                let nearest = sides.map(|(a, b)| from_segment(p, *a, *b)).fold(f64::INFINITY, f64::min);
                if self.contains(p) { nearest } else { -nearest }
            }
            Figure::Stroke(chain, width) => {
                let nearest = chain.windows(2).map(|ends| from_segment(p, ends[0], ends[1]));
                0.5 * width - nearest.fold(f64::INFINITY, f64::min)
            }
        }
    }
}

fn from_segment(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let (ab, ap) = ([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]);
    let square = ab[0] * ab[0] + ab[1] * ab[1];
    let along = if square > 0.0 { ((ab[0] * ap[0] + ab[1] * ap[1]) / square).clamp(0.0, 1.0) } else { 0.0 };
    (ap[0] - along * ab[0]).hypot(ap[1] - along * ab[1])
}

/// A scene prepared for many point queries: a shape is only tested within its bounding box.
#[derive(Clone, Debug)]
pub struct SceneLookup<'a> {
    /// Minimum and maximum coordinates of each inclusion; the last inclusion first.
    boxed: Vec<([f64; 2], [f64; 2], &'a Inclusion)>,
}

impl SceneLookup<'_> {
    /// Class and factor at a point.
    pub fn at(&self, p: [f64; 2]) -> (u8, f64) {
        for (low, high, inclusion) in &self.boxed {
            let near = p[0] >= low[0] && p[0] <= high[0] && p[1] >= low[1] && p[1] <= high[1];
            if near && inclusion.figure.contains(p) {
                return (inclusion.class, inclusion.factor);
            }
        }
        (BACKGROUND, 1.0)
    }
}

impl Scene {
    /// Class and factor at a point.
    pub fn at(&self, p: [f64; 2]) -> (u8, f64) {
        self.lookup().at(p)
    }

    /// Prepares for many point queries.
    pub fn lookup(&self) -> SceneLookup<'_> {
        let mut boxed = Vec::with_capacity(self.inclusions.len());
        for inclusion in self.inclusions.iter().rev() {
            let (low, high) = inclusion.figure.bounds();
            boxed.push((low, high, inclusion));
        }
        SceneLookup { boxed }
    }

    /// Rescales the contrasts of a tank's objects to the given range, linearly in their logarithm.
    pub fn spread_contrasts(&mut self, [least, largest]: [f64; 2]) {
        let [from, to] = OBJECT_CONTRASTS.map(f64::ln);
        for inclusion in &mut self.inclusions {
            let log = inclusion.factor.ln();
            let share = (log.abs() - from) / (to - from);
            let spread = least.ln() + share * (largest.ln() - least.ln());
            inclusion.factor = (log.signum() * spread).exp();
        }
    }

    /// Draws a scene. `size_m` is half the shorter side of the skin; `inside` tells whether a point, in metres from
    /// the skin's middle, is on the skin; `finest_m` is the width of the narrowest cut (one pixel or element).
    pub fn draw(
        kind: SceneKind,
        size_m: f64,
        finest_m: f64,
        inside: &dyn Fn([f64; 2]) -> bool,
        random: &mut StdRng,
    ) -> Self {
        let painter = Painter { size_m, finest_m, inside };
        match kind {
            SceneKind::TouchesAndCuts => painter.touches_and_cuts(random),
            SceneKind::Objects => painter.objects(0.0, random),
            SceneKind::ObjectsAndCrosses => painter.objects(CROSSES, random),
        }
    }
}

/// Minimum and maximum contrast of objects in a tank.
const OBJECT_CONTRASTS: [f64; 2] = [5.0, 100.0];
/// Share of crosses, Ts and stars among objects, if enabled.
const CROSSES: f64 = 0.3;
/// Width of the labelled band of a line cut, as a share of half the skin's width.
const LABELLED_CUT: f64 = 0.08;

struct Painter<'a> {
    size_m: f64,
    finest_m: f64,
    inside: &'a dyn Fn([f64; 2]) -> bool,
}

impl Painter<'_> {
    /// A random point on the skin within this share of the half width from the middle.
    fn place(&self, share: f64, random: &mut StdRng) -> [f64; 2] {
        for _ in 0..1000 {
            let p = [0, 1].map(|_| share * self.size_m * random.random_range(-1.0..1.0));
            if (self.inside)(p) {
                return p;
            }
        }
        [0.0, 0.0]
    }

    /// One of four mixtures: touches, cuts, both, or nothing (8 % of scenes).
    fn touches_and_cuts(&self, random: &mut StdRng) -> Scene {
        let kind: f64 = random.random();
        let (touches, cuts) = match kind {
            k if k < 0.40 => (random.random_range(1..=4), 0),
            k if k < 0.65 => (0, random.random_range(1..=2)),
            k if k < 0.92 => (random.random_range(1..=3), random.random_range(1..=2)),
            _ => (0, 0),
        };
        let mut inclusions: Vec<Inclusion> = (0..cuts).map(|_| self.cut(random)).collect();
        let mut taken: Vec<([f64; 2], f64)> = Vec::new();
        for _ in 0..touches {
            let radius = self.size_m * random.random_range(0.12..0.30);
            let free = (0..50)
                .map(|_| self.place(0.92, random))
                .find(|p| taken.iter().all(|(q, r)| (p[0] - q[0]).hypot(p[1] - q[1]) > r + radius));
            if let Some(middle) = free {
                taken.push((middle, radius));
                let figure = self.footprint(middle, radius, random);
                let factor = 1.0 + random.random_range(0.2_f64.ln()..4.0_f64.ln()).exp();
                inclusions.push(Inclusion { figure, factor, class: RAISED });
            }
        }
        Scene { inclusions }
    }

    fn footprint(&self, middle: [f64; 2], radius: f64, random: &mut StdRng) -> Figure {
        match random.random_range(0..4) {
            0 => {
                let turn = random.random_range(0.0..TAU);
                Figure::Polygon(ring(middle, 4, turn, |_| radius))
            }
            1 => {
                let half = [radius, radius * random.random_range(0.5..1.0)];
                Figure::Ellipse(middle, half, random.random_range(0.0..PI))
            }
            _ => Figure::Ellipse(middle, [radius, radius], 0.0),
        }
    }

    /// A line, an arc or a hole.
    fn cut(&self, random: &mut StdRng) -> Inclusion {
        let start = self.place(0.85, random);
        // Width of the label. The network has to locate a cut to within a few pixels, not a line finer than images
        // resolve.
        let width = (self.size_m * LABELLED_CUT).max(self.finest_m) * random.random_range(1.0..1.4);
        let length = self.size_m * random.random_range(0.2..0.7);
        let direction = random.random_range(0.0..TAU);
        let figure = match random.random_range(0..3) {
            0 => {
                let end = [start[0] + length * direction.cos(), start[1] + length * direction.sin()];
                Figure::Stroke(vec![start, end], width)
            }
            1 => {
                let radius = length / random.random_range(0.8..2.5);
                let turn = length / radius;
                let centre = [start[0] + radius * direction.cos(), start[1] + radius * direction.sin()];
                let point = |k: u32| {
                    let angle = direction + PI + turn * f64::from(k) / 8.0;
                    [centre[0] + radius * angle.cos(), centre[1] + radius * angle.sin()]
                };
                Figure::Stroke((0..=8).map(point).collect(), width)
            }
            _ => {
                let radius = self.size_m * random.random_range(0.05..0.15);
                Figure::Ellipse(start, [radius, radius], 0.0)
            }
        };
        Inclusion { figure, factor: random.random_range(0.005_f64.ln()..0.1_f64.ln()).exp(), class: LOWERED }
    }

    /// Objects, a share of them crossing bars.
    fn objects(&self, crosses: f64, random: &mut StdRng) -> Scene {
        let count = [1, 1, 2, 2, 2, 3, 3, 3, 4][random.random_range(0..9)];
        let mut taken: Vec<([f64; 2], f64)> = Vec::new();
        let mut inclusions = Vec::new();
        for _ in 0..count {
            let radius = self.size_m * random.random_range(0.13..0.42);
            let free = (0..50).map(|_| self.place(0.97 - 0.9 * radius / self.size_m, random)).find(|p| {
                let inside = p[0].hypot(p[1]) + 0.9 * radius < 0.99 * self.size_m;
                inside && taken.iter().all(|(q, r)| (p[0] - q[0]).hypot(p[1] - q[1]) > 0.9 * (r + radius))
            });
            if let Some(middle) = free {
                taken.push((middle, radius));
                let raised = random.random_bool(0.5);
                let contrast: f64 = random.random_range(OBJECT_CONTRASTS[0].ln()..OBJECT_CONTRASTS[1].ln()).exp();
                let factor = if raised { contrast } else { 1.0 / contrast };
                let class = if raised { RAISED } else { LOWERED };
                let is_crossed = crosses > 0.0 && random.random_bool(crosses);
                let figure =
                    if is_crossed { bars(middle, radius, random) } else { self.object(middle, radius, random) };
                inclusions.push(Inclusion { figure, factor, class });
            }
        }
        Scene { inclusions }
    }

    /// Discs, ellipses, bars, regular and irregular polygons, angles, open rings.
    fn object(&self, middle: [f64; 2], radius: f64, random: &mut StdRng) -> Figure {
        let turn = random.random_range(0.0..TAU);
        match random.random_range(0..10) {
            0..=2 => Figure::Ellipse(middle, [radius, radius * random.random_range(0.6..1.0)], turn),
            3 => Figure::Polygon(ring(middle, 3, turn, |_| radius)),
            4 | 5 => {
                let (long, short) = (radius, radius * random.random_range(0.25..0.9));
                let angle = short.atan2(long);
                let corner = |k: usize| [angle, PI - angle, PI + angle, TAU - angle][k] + turn;
                let reach = long.hypot(short).min(1.15 * radius);
                let point = |k: usize| [middle[0] + reach * corner(k).cos(), middle[1] + reach * corner(k).sin()];
                Figure::Polygon((0..4).map(point).collect())
            }
            6 | 7 => {
                let count = random.random_range(5..9);
                let radii: Vec<f64> = (0..count).map(|_| radius * random.random_range(0.55..1.0)).collect();
                Figure::Polygon(ring(middle, count, turn, |k| radii[k]))
            }
            8 => {
                let thick = radius * random.random_range(0.35..0.6);
                let end = |angle: f64| {
                    let reach = radius - 0.5 * thick;
                    [middle[0] + reach * angle.cos(), middle[1] + reach * angle.sin()]
                };
                let bend = random.random_range(0.4..0.8) * PI;
                Figure::Stroke(vec![end(turn), end(turn + PI), end(turn + PI + bend)], thick)
            }
            _ => {
                let thick = radius * random.random_range(0.3..0.5);
                let sweep = random.random_range(0.8..1.6) * PI;
                let reach = radius - 0.5 * thick;
                let point = |k: u32| {
                    let angle = turn + sweep * f64::from(k) / 10.0;
                    [middle[0] + reach * angle.cos(), middle[1] + reach * angle.sin()]
                };
                Figure::Stroke((0..=10).map(point).collect(), thick)
            }
        }
    }
}

/// Three to five bars from a common centre, thin or thick: a cross, a T or a star.
fn bars(middle: [f64; 2], radius: f64, random: &mut StdRng) -> Figure {
    let turn = random.random_range(0.0..TAU);
    let thick = radius * random.random_range(0.18..0.5);
    let (arms, length) = (random.random_range(3..6), radius - 0.5 * thick);
    // A T is a cross with one arm missing.
    let of = if arms == 3 && random.random_bool(0.5) { 4 } else { arms };
    let others = if random.random_bool(0.5) { 1.0 } else { random.random_range(0.5..1.0) };
    let mut chain = Vec::with_capacity(2 * arms + 1);
    for arm in 0..arms {
        let angle = turn + TAU * arm as f64 / of as f64;
        let reach = length * if arm % 2 == 0 { 1.0 } else { others };
        chain.push(middle);
        chain.push([middle[0] + reach * angle.cos(), middle[1] + reach * angle.sin()]);
    }
    Figure::Stroke(chain, thick)
}

fn ring(middle: [f64; 2], count: usize, turn: f64, radius: impl Fn(usize) -> f64) -> Vec<[f64; 2]> {
    (0..count)
        .map(|k| {
            let angle = turn + TAU * k as f64 / count as f64;
            [middle[0] + radius(k) * angle.cos(), middle[1] + radius(k) * angle.sin()]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    /// Area of a shape within a square of side 2.
    fn area(figure: &Figure) -> f64 {
        let side = 400;
        let at = |k: usize| (2.0 * k as f64 + 1.0) / side as f64 - 1.0;
        let (low, high) = figure.bounds();
        let boxed = |p: [f64; 2]| (0..2).all(|axis| p[axis] >= low[axis] && p[axis] <= high[axis]);
        let inside = |k: &usize| {
            let p = [at(k % side), at(k / side)];
            assert!(boxed(p) || !figure.contains(p), "{p:?} is outside the box of {figure:?}");
            figure.contains(p)
        };
        let inside = (0..side * side).filter(inside).count();
        4.0 * inside as f64 / (side * side) as f64
    }

    #[test]
    fn areas_are_those_of_the_formulas() {
        let ellipse = Figure::Ellipse([0.1, -0.1], [0.6, 0.3], 0.7);
        // A grid of 160,000 points; the error of an area comes from its rim and is about a thousandth.
        assert!((area(&ellipse) - PI * 0.18).abs() < 4e-3);
        let square = Figure::Polygon(ring([0.0, 0.0], 4, 0.3, |_| 0.8));
        assert!((area(&square) - 2.0 * 0.64).abs() < 4e-3);
        let stroke = Figure::Stroke(vec![[-0.5, 0.0], [0.5, 0.2]], 0.2);
        assert!((area(&stroke) - (1.04_f64.sqrt() * 0.2 + PI * 0.01)).abs() < 4e-3);
    }

    #[test]
    fn depths_are_distances_from_the_rim() {
        let disc = Figure::Ellipse([1.0, 0.0], [0.5, 0.5], 0.3);
        assert!((disc.depth_m([1.0, 0.2]) - 0.3).abs() < 1e-12 && (disc.depth_m([2.0, 0.0]) + 0.5).abs() < 1e-12);
        assert!((disc.depth_m([1.0, 0.0]) - 0.5).abs() < 1e-12);
        let ellipse = Figure::Ellipse([0.0, 0.0], [2.0, 1.0], 0.0);
        assert!(
            (ellipse.depth_m([1.99, 0.0]) - 0.01).abs() < 1e-4 && (ellipse.depth_m([0.0, 1.01]) + 0.01).abs() < 1e-4
        );
        let square = Figure::Polygon(vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]);
        assert!((square.depth_m([0.5, 0.2]) - 0.2).abs() < 1e-12 && (square.depth_m([2.0, 0.5]) + 1.0).abs() < 1e-12);
        let stroke = Figure::Stroke(vec![[0.0, 0.0], [1.0, 0.0]], 0.4);
        assert!((stroke.depth_m([0.5, 0.1]) - 0.1).abs() < 1e-12 && (stroke.depth_m([1.3, 0.0]) + 0.1).abs() < 1e-12);
    }

    #[test]
    fn later_inclusions_cover_earlier_ones() {
        let disc = |radius: f64, factor: f64, class: u8| Inclusion {
            figure: Figure::Ellipse([0.0, 0.0], [radius, radius], 0.0),
            factor,
            class,
        };
        let scene = Scene { inclusions: vec![disc(1.0, 0.1, LOWERED), disc(0.5, 2.0, RAISED)] };
        assert_eq!(scene.at([0.2, 0.0]), (RAISED, 2.0));
        assert_eq!(scene.at([0.7, 0.0]), (LOWERED, 0.1));
        assert_eq!(scene.at([1.7, 0.0]), (BACKGROUND, 1.0));
    }

    #[test]
    fn contrasts_are_spread_evenly() {
        let object = |factor: f64| {
            let figure = Figure::Ellipse([0.0, 0.0], [1.0, 1.0], 0.0);
            Inclusion { figure, factor, class: if factor > 1.0 { RAISED } else { LOWERED } }
        };
        let mut scene = Scene { inclusions: [5.0, 0.01, 500.0_f64.sqrt()].map(object).to_vec() };
        scene.spread_contrasts([10.0, 1000.0]);
        for (inclusion, expected) in scene.inclusions.iter().zip([10.0, 0.001, 100.0]) {
            assert!((inclusion.factor / expected - 1.0).abs() < 1e-12, "{inclusion:?}");
        }
    }

    #[test]
    fn scenes_are_varied_and_repeatable() {
        let draw = |kind: SceneKind, seed: u64| {
            let mut random = StdRng::seed_from_u64(seed);
            Scene::draw(kind, 0.05, 0.0016, &|p| p[0].abs().max(p[1].abs()) < 0.05, &mut random)
        };
        let has = |scene: &Scene, class: u8| scene.inclusions.iter().any(|i| i.class == class);
        let scenes: Vec<Scene> = (0..400).map(|seed| draw(SceneKind::TouchesAndCuts, seed)).collect();
        let count = |test: &dyn Fn(&Scene) -> bool| scenes.iter().filter(|scene| test(scene)).count();
        // Touches only 0.40, cuts only 0.25, both 0.27, nothing 0.08; four standard deviations over 400 draws.
        let near = |found: usize, share: f64| {
            (found as f64 / 400.0 - share).abs() < 4.0 * (share * (1.0 - share) / 400.0_f64).sqrt()
        };
        assert!(near(count(&|s| has(s, RAISED) && !has(s, LOWERED)), 0.40));
        assert!(near(count(&|s| !has(s, RAISED) && has(s, LOWERED)), 0.25));
        assert!(near(count(&|s| s.inclusions.is_empty()), 0.08));
        assert_eq!(draw(SceneKind::Objects, 3), draw(SceneKind::Objects, 3));
        assert_ne!(draw(SceneKind::Objects, 3), draw(SceneKind::Objects, 4));
        let (mut crossed, mut all) = (0, 0);
        for seed in 0..400 {
            for kind in [SceneKind::Objects, SceneKind::ObjectsAndCrosses] {
                for inclusion in draw(kind, seed).inclusions {
                    assert_eq!(inclusion.class == RAISED, inclusion.factor > 1.0);
                    // Every bar starts in the middle again.
                    let is_crossed = match &inclusion.figure {
                        Figure::Stroke(chain, _) => chain.len() > 4 && chain[0] == chain[2],
                        _ => false,
                    };
                    assert!(!is_crossed || kind == SceneKind::ObjectsAndCrosses);
                    if kind == SceneKind::ObjectsAndCrosses {
                        (crossed, all) = (crossed + u32::from(is_crossed), all + 1);
                    }
                }
            }
        }
        // About 900 objects; four standard deviations are 0.06.
        assert!((f64::from(crossed) / f64::from(all) - CROSSES).abs() < 0.06, "{crossed} of {all}");
    }
}
