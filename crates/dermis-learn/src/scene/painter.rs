//! Random inclusions: touches and cuts of a skin, or objects in a tank.

use std::f64::consts::{PI, TAU};

use rand::Rng;
use rand::rngs::StdRng;

use super::figure::{Figure, Inclusion, LOWERED, RAISED, distance, ring};

/// Minimum and maximum contrast of objects in a tank.
pub(super) const OBJECT_CONTRASTS: [f64; 2] = [5.0, 100.0];
/// Share of crosses, Ts and stars among objects, if enabled.
pub(super) const CROSSES: f64 = 0.3;
/// Width of the labelled band of a line cut, as a share of half the skin's width.
const LABELLED_CUT: f64 = 0.08;

/// Draws inclusions at random.
pub(super) struct Painter<'a> {
    /// Half the shorter side of the skin, metres.
    pub size_m: f64,
    /// Width of the narrowest cut, metres.
    pub finest_m: f64,
    /// True if a point, in metres from the skin's middle, is on the skin.
    pub inside: &'a dyn Fn([f64; 2]) -> bool,
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
    pub fn touches_and_cuts(&self, random: &mut StdRng) -> Vec<Inclusion> {
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
                .find(|p| taken.iter().all(|(q, r)| distance(*p, *q) > r + radius));
            if let Some(middle) = free {
                taken.push((middle, radius));
                let figure = self.footprint(middle, radius, random);
                let factor = 1.0 + random.random_range(0.2_f64.ln()..4.0_f64.ln()).exp();
                inclusions.push(Inclusion { figure, factor, class: RAISED });
            }
        }
        inclusions
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
    pub fn objects(&self, crosses: f64, random: &mut StdRng) -> Vec<Inclusion> {
        let count = [1, 1, 2, 2, 2, 3, 3, 3, 4][random.random_range(0..9)];
        let mut taken: Vec<([f64; 2], f64)> = Vec::new();
        let mut inclusions = Vec::new();
        for _ in 0..count {
            let radius = self.size_m * random.random_range(0.13..0.42);
            let free = (0..50).map(|_| self.place(0.97 - 0.9 * radius / self.size_m, random)).find(|p| {
                let inside = p[0].hypot(p[1]) + 0.9 * radius < 0.99 * self.size_m;
                inside && taken.iter().all(|(q, r)| distance(*p, *q) > 0.9 * (r + radius))
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
        inclusions
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
