//! [`PyTwin`]: a skin's digital twin, pressed and stepped by hand.

use std::sync::Mutex;

use dermis_skin::Skin;
use dermis_twin::instrument::FrameFate;
use dermis_twin::mechanics::{Indenter, Load, Shape};
use dermis_twin::scene::{Scene, SceneOptions};
use dermis_twin::{AnyTwin, Frontend as _, TouchTruth, TwinKit};
use pyo3::prelude::*;

use crate::errors::{Fault, Kind};
use crate::frame::PyFrame;
use crate::hints::Named;
use crate::skin::{PySkin, skin_of};
use crate::skin_argument::SkinLike;
use crate::work::{lock, run, run_interruptibly};

/// Longest fade, seconds.
const MOST_FADE_S: f64 = 60.0;
/// Steps without a frame after which to give up on an instrument that loses all frames.
const MOST_LOST: usize = 10_000;

struct Running {
    twin: AnyTwin,
    time_s: f64,
    truth: Vec<TouchTruth>,
    values: Vec<f64>,
}

/// The digital twin of a skin: mechanics, fields and instrument, on a mesh other than the reconstruction's.
///
/// Parameters
/// ----------
/// skin : Skin or str
///     The skin.
/// seed : int, optional
///     Seed of the instrument's noise; default: the skin file's. The same seed gives identical bits.
/// fade_s : float
///     Time in which a press fades in and out, seconds. With 0 loads act at once, as needed for a simulator.
#[pyclass(frozen, module = "dermis", name = "Twin")]
pub struct PyTwin {
    skin: Skin,
    period_s: f64,
    press: dermis_twin::PressRange,
    running: Mutex<Running>,
}

/// Radius (metres) of a pressing disc and its force or pressure, only one of which may be given; the defaults are in
/// metres and pascals.
pub fn radius_and_load(
    radius_mm: Option<f64>,
    force_n: Option<f64>,
    pressure_kpa: Option<f64>,
    (usual_m, usual_pa): (f64, f64),
) -> Result<(f64, Load), Fault> {
    let load = match (force_n, pressure_kpa) {
        (Some(force_n), None) => Load::ForceN(force_n),
        (None, pressure_kpa) => Load::PressurePa(pressure_kpa.map_or(usual_pa, |kpa| 1e3 * kpa)),
        (Some(_), Some(_)) => return Err(Fault::new(Kind::Input, "press: expected force_n or pressure_kpa, got both")),
    };
    Ok((radius_mm.map_or(usual_m, |mm| 1e-3 * mm), load))
}

#[pymethods]
impl PyTwin {
    #[new]
    #[pyo3(signature = (skin, seed=None, *, fade_s=0.08))]
    fn new(py: Python<'_>, skin: SkinLike<'_>, seed: Option<u64>, fade_s: f64) -> PyResult<Self> {
        let mut skin = skin_of(&skin)?;
        if !(0.0..=MOST_FADE_S).contains(&fade_s) {
            return Err(Fault::input("fade_s", format!("0 to {MOST_FADE_S} seconds"), fade_s).into());
        }
        // Numbers in a skin file are signed.
        if seed.is_some_and(|seed| i64::try_from(seed).is_err()) {
            return Err(Fault::input("seed", "0 to 2^63 - 1", seed.unwrap_or_default()).into());
        }
        skin.twin.seed = seed.or(skin.twin.seed);
        let of = skin.clone();
        let kit = run_interruptibly(py, "twin", move || {
            let mut kit = TwinKit::of(&of)?;
            // Every time step is longer than the shortest fade.
            let options = SceneOptions { fade_s: fade_s.max(f64::MIN_POSITIVE), ..SceneOptions::default() };
            *kit.twin.scene_mut() = Scene::new(options, None)?.on(kit.twin.frontend().extent())?;
            Ok(kit)
        })?;
        let period_s = 1.0 / skin.backend.frame_rate_hz();
        let running = Running { twin: kit.twin, time_s: 0.0, truth: Vec::new(), values: Vec::new() };
        Ok(Self { skin, period_s, press: kit.press, running: Mutex::new(running) })
    }

    /// The skin.
    #[getter]
    fn skin(&self) -> PySkin {
        PySkin { skin: self.skin.clone() }
    }

    /// Time between frames, seconds.
    #[getter]
    fn period_s(&self) -> f64 {
        self.period_s
    }

    /// Time of the next frame, seconds.
    #[getter]
    fn time_s(&self) -> f64 {
        lock(&self.running).time_s
    }

    /// Presses with a round indenter from the next frame on, or changes a current press.
    ///
    /// Parameters
    /// ----------
    /// x_mm, y_mm : float
    ///     Position, from the skin's centre.
    /// radius_mm, force_n : float, optional
    ///     Radius and force; default: the skin's usual press.
    /// pressure_kpa : float, optional
    ///     Mean pressure, instead of a force.
    /// pointer : int
    ///     Identifies the press, since several are possible at once.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     The position is off the skin, or a number is invalid.
    #[pyo3(signature = (x_mm, y_mm, radius_mm=None, force_n=None, *, pressure_kpa=None, pointer=1))]
    fn press(
        &self,
        py: Python<'_>,
        x_mm: f64,
        y_mm: f64,
        radius_mm: Option<f64>,
        force_n: Option<f64>,
        pressure_kpa: Option<f64>,
        pointer: u64,
    ) -> PyResult<()> {
        let usual = (self.press.initial_radius_m, self.press.initial_pressure_pa);
        let (radius_m, load) = radius_and_load(radius_mm, force_n, pressure_kpa, usual)?;
        let indenter = Indenter { centre_m: [1e-3 * x_mm, 1e-3 * y_mm], shape: Shape::Disc { radius_m }, load };
        run(py, || {
            let mut running = lock(&self.running);
            running.twin.frontend().check_indenter(&indenter)?;
            Ok(running.twin.scene_mut().press_with(pointer, indenter)?)
        })
    }

    /// Ends a press.
    ///
    /// Parameters
    /// ----------
    /// pointer : int, optional
    ///     The press to end; default: all.
    #[pyo3(signature = (pointer=None))]
    fn release(&self, py: Python<'_>, pointer: Option<u64>) -> PyResult<()> {
        run(py, || {
            let mut running = lock(&self.running);
            match pointer {
                Some(pointer) => running.twin.scene_mut().release(pointer),
                None => running.twin.scene_mut().release_all(),
            }
            Ok(())
        })
    }

    /// Returns the next frame.
    ///
    /// Parameters
    /// ----------
    /// dt_s : float, optional
    ///     Time until the following frame; default: the period.
    ///
    /// Returns
    /// -------
    /// Frame
    #[pyo3(signature = (dt_s=None))]
    fn step(&self, py: Python<'_>, dt_s: Option<f64>) -> PyResult<PyFrame> {
        let dt_s = dt_s.unwrap_or(self.period_s);
        if !(dt_s > 0.0 && dt_s <= 86_400.0) {
            return Err(Fault::input("dt_s", "seconds, above 0 and at most a day", dt_s).into());
        }
        run(py, || {
            let mut running = lock(&self.running);
            let Running { twin, time_s, truth, values } = &mut *running;
            for _ in 0..MOST_LOST {
                let at_s = *time_s;
                *time_s += dt_s;
                let seen = twin.step(at_s, values)?;
                truth.clone_from(&seen.touches);
                if seen.fate != FrameFate::Dropped {
                    let sequence = seen.sequence;
                    return Ok(PyFrame::timed(sequence, at_s, values, twin.instrument().imaginary_v()));
                }
            }
            Err(Fault::new(Kind::Source, format!("the twin's instrument has lost {MOST_LOST} frames in a row")))
        })
    }

    /// The true presses in the last frame: for each a dictionary with ``x_mm``, ``y_mm``, ``radius_mm``,
    /// ``pressure_kpa``, ``force_n``.
    #[getter]
    fn truth<'py>(&self, py: Python<'py>) -> PyResult<Vec<Named<'py, f64>>> {
        let row = |touch: &TouchTruth| {
            let force_n = touch.pressure_pa * std::f64::consts::PI * touch.radius_m * touch.radius_m;
            Named::of(
                py,
                [
                    ("x_mm", 1e3 * touch.x_m),
                    ("y_mm", 1e3 * touch.y_m),
                    ("radius_mm", 1e3 * touch.radius_m),
                    ("pressure_kpa", 1e-3 * touch.pressure_pa),
                    ("force_n", force_n),
                ],
            )
        };
        lock(&self.running).truth.iter().map(row).collect()
    }

    fn __repr__(&self) -> String {
        format!("<dermis.Twin of {:?} at {:.3} s>", self.skin.name, self.time_s())
    }
}
