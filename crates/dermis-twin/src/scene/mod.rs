//! Loads on a twin over time: scripted touches and touches by pointers (a mouse, a finger on a screen), merged. Every
//! touch fades in and out, so nothing jumps, however it begins or ends.

mod random;
mod script;
mod waveforms;

use std::collections::BTreeMap;

use dermis_tomo::mesh::Outline;
use serde::{Deserialize, Serialize};

use crate::error::{TwinError, check_positive};
use crate::mechanics::{Indenter, Load, check_on_skin};
pub use random::RandomTouches;
pub use script::{Event, Script};
pub use waveforms::Place;

/// Source of a touch. Script and user count their pointers separately.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Pointer {
    /// A pointer of the script.
    Script(u64),
    /// A pointer of the user.
    User(u64),
}

/// Timing of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SceneOptions {
    /// Fade time of a touch, in and out, seconds.
    pub fade_s: f64,
    /// The script pauses and its touches fade out while a user presses and for this long afterwards, seconds. With
    /// zero, the script continues alongside.
    pub script_waits_s: f64,
}

impl Default for SceneOptions {
    fn default() -> Self {
        Self { fade_s: 0.08, script_waits_s: 5.0 }
    }
}

#[derive(Clone, Debug)]
struct Touch {
    indenter: Indenter,
    /// 0 released, 1 pressed; the share of the load is the smoothstep of this.
    level: f64,
    down: bool,
}

/// All loads over time.
#[derive(Clone, Debug)]
pub struct Scene {
    options: SceneOptions,
    script: Option<Script>,
    script_time_s: f64,
    since_user_s: f64,
    touches: BTreeMap<Pointer, Touch>,
    /// Outline on which presses must lie, if known.
    skin: Option<Outline>,
}

impl Scene {
    /// An empty scene, with or without a script.
    ///
    /// # Errors
    /// Invalid times, or a script that fails [`Script::check`].
    pub fn new(options: SceneOptions, script: Option<Script>) -> Result<Self, TwinError> {
        check_positive("fade_s", options.fade_s)?;
        crate::error::check("script_waits_s", options.script_waits_s, 0.0, f64::MAX, "zero or more, finite")?;
        script.as_ref().map_or(Ok(()), Script::check)?;
        let touches = BTreeMap::new();
        Ok(Self { options, script, script_time_s: 0.0, since_user_s: f64::INFINITY, touches, skin: None })
    }

    /// The same on a skin with this outline; later presses off the skin are refused.
    ///
    /// # Errors
    /// A script with presses off the skin or indenters larger than it.
    pub fn on(self, skin: Outline) -> Result<Self, TwinError> {
        self.script.as_ref().map_or(Ok(()), |script| script.check_on(&skin))?;
        Ok(Self { skin: Some(skin), ..self })
    }

    /// Replaces the script (`None` ends it); the new one starts at its beginning.
    ///
    /// # Errors
    /// A script that fails [`Script::check`] or presses off the skin.
    pub fn set_script(&mut self, script: Option<Script>) -> Result<(), TwinError> {
        script.as_ref().map_or(Ok(()), |script| match &self.skin {
            Some(skin) => script.check_on(skin),
            None => script.check(),
        })?;
        (self.script, self.script_time_s) = (script, 0.0);
        Ok(())
    }

    /// Presses with a round indenter; a pointer that is already pressing moves and changes to this one.
    ///
    /// # Errors
    /// Non-finite numbers, a radius that is not positive, a negative pressure, a position off the skin, or an
    /// indenter larger than the skin.
    pub fn press(
        &mut self,
        pointer: u64,
        x_m: f64,
        y_m: f64,
        radius_m: f64,
        pressure_pa: f64,
    ) -> Result<(), TwinError> {
        self.press_with(pointer, Indenter::disc([x_m, y_m], radius_m, pressure_pa))
    }

    /// Presses with any indenter.
    ///
    /// # Errors
    /// As [`Scene::press`].
    pub fn press_with(&mut self, pointer: u64, indenter: Indenter) -> Result<(), TwinError> {
        self.check(&indenter)?;
        self.hold(Pointer::User(pointer), indenter);
        Ok(())
    }

    /// Moves a pressing pointer.
    ///
    /// # Errors
    /// A pointer that is not pressing, or a position that is not finite or off the skin.
    pub fn move_to(&mut self, pointer: u64, x_m: f64, y_m: f64) -> Result<(), TwinError> {
        let touch = self.touches.get(&Pointer::User(pointer)).filter(|touch| touch.down);
        let moved = touch.map(|touch| Indenter { centre_m: [x_m, y_m], ..touch.indenter });
        let moved = moved.ok_or(TwinError::Pointer { pointer })?;
        self.press_with(pointer, moved)
    }

    /// True while this user pointer presses.
    pub fn is_pressed_by(&self, pointer: u64) -> bool {
        self.touches.get(&Pointer::User(pointer)).is_some_and(|touch| touch.down)
    }

    fn check(&self, indenter: &Indenter) -> Result<(), TwinError> {
        match &self.skin {
            Some(skin) => check_on_skin(skin, indenter),
            None => indenter.check(),
        }
    }

    /// Releases a pointer; a pointer that is not pressing is left unchanged.
    pub fn release(&mut self, pointer: u64) {
        if let Some(touch) = self.touches.get_mut(&Pointer::User(pointer)) {
            touch.down = false;
        }
    }

    /// Releases all user pointers.
    pub fn release_all(&mut self) {
        for (pointer, touch) in &mut self.touches {
            touch.down &= matches!(pointer, Pointer::Script(_));
        }
    }

    /// Advances by `dt_s` seconds.
    pub fn advance(&mut self, dt_s: f64) {
        let pressed = self.touches.iter().any(|(pointer, touch)| matches!(pointer, Pointer::User(_)) && touch.down);
        self.since_user_s = if pressed { 0.0 } else { self.since_user_s + dt_s };
        let waits = self.options.script_waits_s > 0.0 && self.since_user_s < self.options.script_waits_s;
        self.follow_script(dt_s, waits);
        let change = dt_s / self.options.fade_s;
        self.touches.retain(|_, touch| {
            touch.level = if touch.down { (touch.level + change).min(1.0) } else { touch.level - change };
            touch.down || touch.level > 0.0
        });
    }

    /// The current touches with their faded loads, ordered by pointer.
    pub fn indenters(&self) -> impl Iterator<Item = (Pointer, Indenter)> + '_ {
        self.touches.iter().map(|(pointer, touch)| {
            let share = touch.level * touch.level * (3.0 - 2.0 * touch.level);
            (*pointer, touch.indenter.scaled(share))
        })
    }

    fn hold(&mut self, pointer: Pointer, indenter: Indenter) {
        let touch = self.touches.entry(pointer).or_insert(Touch { indenter, level: 0.0, down: true });
        (touch.indenter, touch.down) = (indenter, true);
    }

    fn follow_script(&mut self, dt_s: f64, waits: bool) {
        for (pointer, touch) in &mut self.touches {
            touch.down &= matches!(pointer, Pointer::User(_));
        }
        let Some(script) = self.script.take() else { return };
        if !waits {
            self.script_time_s += dt_s;
            for (pointer, indenter) in script.at(self.script_time_s) {
                self.hold(Pointer::Script(pointer), indenter);
            }
        }
        self.script = Some(script);
    }
}

impl Indenter {
    /// False for a zero load, which a press cannot have.
    pub(crate) fn is_pressing(&self) -> bool {
        match self.load {
            Load::PressurePa(value) | Load::ForceN(value) => value > 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pressure(scene: &Scene) -> f64 {
        scene.indenters().map(|(_, indenter)| indenter.pressure_pa()).sum()
    }

    #[test]
    fn touches_fade_in_follow_and_fade_out() {
        let mut scene = Scene::new(SceneOptions::default(), None).unwrap();
        scene.press(3, 0.01, 0.0, 0.01, 50e3).unwrap();
        let mut last = 0.0;
        for _ in 0..8 {
            scene.advance(0.01);
            let now = pressure(&scene);
            // A smoothstep in eight parts rises by at most 1.5/8 of the total per part.
            assert!(now > last && now - last < 0.19 * 50e3, "{last} {now}");
            last = now;
        }
        assert!((last - 50e3).abs() < 1e-6);
        scene.move_to(3, 0.02, -0.01).unwrap();
        scene.advance(0.01);
        let (pointer, indenter) = scene.indenters().next().unwrap();
        assert_eq!((pointer, indenter.centre_m), (Pointer::User(3), [0.02, -0.01]));
        scene.release(3);
        scene.advance(0.04);
        assert!((pressure(&scene) - 25e3).abs() < 1.0);
        assert!(matches!(scene.move_to(3, 0.0, 0.0), Err(TwinError::Pointer { pointer: 3 })));
        scene.advance(0.05);
        assert_eq!(scene.indenters().count(), 0);
        scene.release(3);
    }

    #[test]
    fn script_waits_while_someone_presses() {
        let mut scene = Scene::new(SceneOptions::default(), Some(Script::demo())).unwrap();
        scene.advance(1.5);
        assert!(scene.indenters().all(|(pointer, _)| matches!(pointer, Pointer::Script(_))));
        assert_eq!(scene.indenters().count(), 1);
        scene.press(1, 0.0, 0.0, 0.01, 50e3).unwrap();
        (0..10).for_each(|_| scene.advance(0.02));
        let now: Vec<Pointer> = scene.indenters().map(|touch| touch.0).collect();
        assert_eq!(now, [Pointer::User(1)]);
        scene.release_all();
        (0..300).for_each(|_| scene.advance(0.02));
        assert_eq!(scene.indenters().count(), 1);
    }
}
