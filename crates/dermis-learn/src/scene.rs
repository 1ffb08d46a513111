//! Random scenes for training: shapes on a skin, each with a conductivity factor and a class. Pure geometry in the
//! plane of the sheet; the physics is elsewhere.

mod figure;
mod painter;

use rand::rngs::StdRng;
use serde::{Deserialize, Serialize};

pub use figure::{BACKGROUND, Figure, Inclusion, LOWERED, RAISED};
use painter::{CROSSES, OBJECT_CONTRASTS, Painter};

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
        let inclusions = match kind {
            SceneKind::TouchesAndCuts => painter.touches_and_cuts(random),
            SceneKind::Objects => painter.objects(0.0, random),
            SceneKind::ObjectsAndCrosses => painter.objects(CROSSES, random),
        };
        Self { inclusions }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

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
