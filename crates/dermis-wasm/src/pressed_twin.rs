//! A twin pressed by one page: its frames, its demonstration while idle, and its refusals.

use dermis_live::pipeline::TARE_FRAMES;
use dermis_page::Press;
use dermis_skin::Skin;
use dermis_twin::scene::Script;
use dermis_twin::{AnyTwin, PressRange, Treatment, TwinError, TwinKit};

/// Frames without touches at the start, for a baseline; the demonstration starts after them.
const REST_FRAMES: u64 = TARE_FRAMES as u64 + 4;

/// A twin and the presses on it.
#[derive(Debug)]
pub(crate) struct PressedTwin {
    twin: AnyTwin,
    press: PressRange,
    demo: Script,
    wants_demo: bool,
    demonstrates: bool,
    frames: u64,
    values: Vec<f64>,
}

impl PressedTwin {
    /// The twin of a skin.
    ///
    /// # Errors
    /// Fails if the skin has no twin or the twin cannot be built.
    pub(crate) fn new(skin: &Skin) -> Result<Self, TwinError> {
        let TwinKit { twin, press, demo } = TwinKit::of(skin)?;
        Ok(Self { twin, press, demo, wants_demo: true, demonstrates: false, frames: 0, values: Vec::new() })
    }

    /// Range of presses available to users.
    pub(crate) fn press_range(&self) -> PressRange {
        self.press
    }

    /// Number of channels in a frame.
    pub(crate) fn channels(&self) -> usize {
        self.twin.frontend().channel_count()
    }

    /// The next frame, at `time_s`: its number and its readings, real and imaginary, volts. The imaginary part is
    /// empty for instruments that read real values.
    ///
    /// # Errors
    /// Fails if the fields cannot be solved.
    pub(crate) fn step(&mut self, time_s: f64) -> Result<(u64, &[f64], &[f64]), TwinError> {
        if self.wants_demo && !self.demonstrates && self.frames >= REST_FRAMES {
            self.twin.scene_mut().set_script(Some(self.demo.clone()))?;
            self.demonstrates = true;
        }
        self.frames += 1;
        let sequence = self.twin.step(time_s, &mut self.values)?.sequence;
        Ok((sequence, &self.values, self.twin.instrument().imaginary_v()))
    }

    /// Turns the demonstration of touches while idle on or off.
    ///
    /// # Errors
    /// Never for a twin that could be built.
    pub(crate) fn demonstrate(&mut self, wanted: bool) -> Result<(), TwinError> {
        self.wants_demo = wanted;
        if !wanted && std::mem::take(&mut self.demonstrates) {
            self.twin.scene_mut().set_script(None)?;
        }
        Ok(())
    }

    /// Starts or moves a press. A pointer that slides off the skin releases silently, and presses again where it
    /// comes back.
    ///
    /// # Errors
    /// Fails if the press is invalid or starts off the skin; existing presses remain.
    pub(crate) fn press(&mut self, press: &Press) -> Result<(), TwinError> {
        let (pointer, place_m) = (press.pointer_id, press.position_m());
        let is_off = !self.twin.frontend().extent().contains(place_m);
        let scene = self.twin.scene_mut();
        if is_off && scene.is_pressed_by(pointer) {
            scene.release(pointer);
            return Ok(());
        }
        scene.press(pointer, place_m[0], place_m[1], press.radius_m(), press.pressure_pa())
    }

    /// Releases a press.
    pub(crate) fn release(&mut self, pointer: u64) {
        self.twin.scene_mut().release(pointer);
    }

    /// Cuts, heats or renews the sheet.
    ///
    /// # Errors
    /// Fails if the skin's sheet does not support it.
    pub(crate) fn treat(&mut self, treatment: &Treatment) -> Result<(), TwinError> {
        self.demonstrate(false)?;
        self.twin.frontend_mut().treat(treatment)
    }
}
