//! One skin as built: draws manufacturing errors and applies them to the skin file's numbers or in addition to them.

use dermis_skin::{CoilPlaces, ContactLaw, Dice, Layer, Skin, Tolerances, Winding, built_electrodes};
use dermis_twin::instrument::{Instrument, InstrumentOptions, Noise};
use dermis_twin::{AsBuilt, Frontend, TwinKit};

use super::cause::{Cause, causes};
use super::conductivity;
use crate::Error;

const MM: f64 = 1e-3;
/// Scatter of element heights if the file of tolerances doesn't state it; the skin's own scatter is added.
const ELEMENT_HEIGHT_MM: f64 = 0.3;
/// Minimum share of the gap between coils to keep.
const LEAST_COIL_GAP: f64 = 0.2;

/// A skin as built.
#[derive(Debug)]
pub(super) struct Built {
    /// Skin with the actual material and mechanics.
    pub skin: Skin,
    /// Actual geometry.
    pub as_built: AsBuilt,
    /// Gain factor of each channel.
    pub gains: Vec<f64>,
    /// Factor on the instrument's noise.
    pub noise: f64,
    /// Electrode or coil without contact, from 0.
    pub bad: Option<u32>,
    /// True if only the instrument and its wires have errors.
    pub is_as_drawn: bool,
}

/// Builds a sample with errors from these causes.
pub(super) fn build(
    skin: &Skin,
    channels: usize,
    tolerances: &Tolerances,
    causes: &[Cause],
    [seed, sample]: [u64; 2],
) -> Result<Built, Error> {
    let mut built = Built {
        skin: as_drawn(skin),
        as_built: AsBuilt::nominal(skin),
        gains: vec![1.0; channels],
        noise: 1.0,
        bad: None,
        is_as_drawn: causes.iter().all(|cause| matches!(cause, Cause::Gain | Cause::Noise | Cause::BadElectrode)),
    };
    let dice = |cause: Cause| Dice::new(seed, sample, cause as u64 + 1);
    let share = |cause: Cause, percent: f64| if causes.contains(&cause) { 0.01 * percent } else { 0.0 };
    let outline = skin.outline();
    let place_mm = if causes.contains(&Cause::ElectrodePlaces) { tolerances.electrode_place_mm } else { 0.0 };
    let width = share(Cause::ElectrodeWidths, tolerances.electrode_width_percent);
    if place_mm > 0.0 || width > 0.0 {
        let dice = [&mut dice(Cause::ElectrodePlaces), &mut dice(Cause::ElectrodeWidths)];
        built.as_built.electrodes = built_electrodes(&outline, &built.as_built.electrodes, place_mm * MM, width, dice);
    }
    for cause in causes {
        let mut dice = dice(*cause);
        match cause {
            Cause::ElectrodePlaces | Cause::ElectrodeWidths => {}
            Cause::ContactImpedance => {
                let log = tolerances.contact_impedance_factor.ln();
                built.as_built.contact_factors.iter_mut().for_each(|factor| *factor = (log * dice.normal()).exp());
            }
            Cause::Conductivity => {
                let (low, high) = outline.bounds_m();
                let shorter_m = (high[0] - low[0]).min(high[1] - low[1]);
                let length_m = tolerances.conductivity_length_share * shorter_m;
                let deviation = 0.01 * tolerances.conductivity_percent;
                built.as_built.conductance = conductivity::map(&outline, deviation, length_m, &mut dice);
            }
            Cause::Thickness => {
                thicken(&mut built.skin.frontend.layer, 1.0 + 0.01 * tolerances.thickness_percent * dice.normal());
            }
            Cause::ContactLaw => {
                let deviation = 0.01 * tolerances.contact_law_percent;
                answer(&mut built.skin.frontend.layer, [(); 3].map(|()| 1.0 + deviation * dice.normal()));
            }
            Cause::CoilPlaces => move_coils(&mut built.skin, tolerances.coil_place_mm, &mut dice)?,
            Cause::ElementHeights => scatter_heights(&mut built.skin, skin, tolerances.element_height_mm, &mut dice),
            Cause::Stiffness => {
                if let Layer::Elements(layer) = &mut built.skin.frontend.layer {
                    let factor = 1.0 + 0.01 * tolerances.stiffness_percent * dice.normal();
                    layer.stiffness_n_per_m *= factor;
                    layer.coupling_n_per_m *= factor;
                }
            }
            Cause::Gain => {
                let deviation = 0.01 * tolerances.gain_percent;
                built.gains.iter_mut().for_each(|gain| *gain = 1.0 + deviation * dice.normal());
            }
            Cause::Noise => built.noise = (0.01 * tolerances.noise_percent * dice.normal()).exp(),
            Cause::BadElectrode => built.bad = Some(dice.below(skin.electrode_shapes().len()) as u32),
        }
    }
    Ok(built)
}

impl Built {
    /// The instrument of a skin as drawn, with this skin's noise.
    pub fn instrument(&self, drawn: InstrumentOptions, seed: u64) -> Result<Instrument, Error> {
        let Noise { floor_v, proportional } = drawn.noise;
        let noise = Noise { floor_v: self.noise * floor_v, proportional: self.noise * proportional };
        Ok(Instrument::new(InstrumentOptions { noise, ..drawn }, self.gains.len(), seed)?)
    }
}

/// The frontend of a built skin, the instrument that reads it, and the gain of each channel.
type BuiltTwin = (Box<dyn Frontend>, Instrument, Vec<f64>);

/// Builds skin number `number` within its file's tolerances.
pub(crate) fn built_twin(skin: &Skin, number: u64) -> Result<BuiltTwin, Error> {
    let channels = skin.protocol()?.channel_count();
    let causes = causes(&skin.tolerances, skin);
    let built = build(skin, channels, &skin.tolerances, &causes, [number, 0])?;
    let (frontend, drawn, _) = TwinKit::built(&built.skin, &built.as_built)?.twin.into_parts();
    let instrument = built.instrument(*drawn.options(), dermis_twin::from_skin::seed_of(skin))?;
    let instrument = frontend.wired(instrument)?;
    Ok((frontend, instrument, built.gains))
}

/// The skin without the element scatter and later faults that its own file specifies.
pub(super) fn as_drawn(skin: &Skin) -> Skin {
    let mut drawn = skin.clone();
    drawn.twin.faults.clear();
    drawn.twin.treatments.clear();
    if let Layer::Elements(layer) = &mut drawn.frontend.layer {
        layer.height_tolerance_mm = 0.0;
    }
    drawn
}

fn thicken(layer: &mut Layer, factor: f64) {
    match layer {
        Layer::Sheet(layer) => layer.thickness_mm *= factor,
        Layer::Sandwich(layer) => layer.thickness_mm *= factor,
        Layer::Patches(layer) => layer.thickness_mm *= factor,
        Layer::Liquid(layer) => {
            layer.depth_mm *= factor;
            layer.electrode_height_mm = layer.electrode_height_mm.map(|height| height.min(layer.depth_mm));
        }
        Layer::Elements(_) => {}
    }
}

fn answer(layer: &mut Layer, factors: [f64; 3]) {
    let law = |law: &mut ContactLaw| {
        law.threshold_kpa *= factors[0];
        law.reference_kpa *= factors[1];
        law.saturation_s_per_m2 *= factors[2];
    };
    match layer {
        Layer::Sandwich(layer) => law(&mut layer.contact),
        Layer::Patches(layer) => law(&mut layer.contact),
        Layer::Sheet(layer) => {
            layer.modulus_kpa *= factors[0];
            layer.pressure_percent_per_kpa *= factors[1];
        }
        Layer::Liquid(layer) => layer.tension_n_per_m *= factors[0],
        Layer::Elements(_) => {}
    }
}

fn scatter_heights(built: &mut Skin, drawn: &Skin, height_mm: Option<f64>, dice: &mut Dice) {
    let (Layer::Elements(own), Layer::Elements(layer)) = (&drawn.frontend.layer, &mut built.frontend.layer) else {
        return;
    };
    let most_mm = drawn.frontend.elements.as_ref().map_or(0.0, |elements| 0.1 * elements.pitch_m() / MM);
    let scatter_mm = height_mm.unwrap_or(ELEMENT_HEIGHT_MM.hypot(own.height_tolerance_mm));
    layer.height_tolerance_mm = scatter_mm.min(most_mm);
    built.twin.seed = Some(dice.seed());
}

/// Moves the coils. Each keeps a fifth of the gap to its neighbours; coils that overlap in the drawing may still do
/// so.
fn move_coils(skin: &mut Skin, place_mm: f64, dice: &mut Dice) -> Result<(), Error> {
    let Some(coils) = skin.frontend.coils.as_mut().filter(|_| place_mm > 0.0) else { return Ok(()) };
    let drawn: Vec<[f64; 3]> = coils.places_m()?.iter().map(|place| place.map(|m| m / MM)).collect();
    let gap = |a: &[f64; 3], b: &[f64; 3]| {
        let [x, y] = [a[0] - b[0], a[1] - b[1]];
        let apart = if coils.shape == Winding::Round { x.hypot(y) } else { x.abs().max(y.abs()) };
        apart - coils.outer_mm
    };
    let mut built = drawn.clone();
    for (index, place) in drawn.iter().enumerate() {
        for _ in 0..20 {
            let moved = [place[0] + place_mm * dice.normal(), place[1] + place_mm * dice.normal(), place[2]];
            let clear = (0..drawn.len()).filter(|other| *other != index).all(|other| {
                let as_drawn = gap(place, &drawn[other]);
                as_drawn < -1e-6 || gap(&moved, &built[other]) >= LEAST_COIL_GAP * as_drawn.max(0.0)
            });
            if clear {
                built[index] = moved;
                break;
            }
        }
    }
    coils.places = CoilPlaces::List(built);
    Ok(())
}
