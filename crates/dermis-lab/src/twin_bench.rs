//! A twin on the bench: pressed with known forces, read with noise, and imaged as its skin file says.

use dermis_mit::LiftOffFit;
use dermis_tomo::mesh::{Point, Surface, distance};
use dermis_touch::force::ForceCalibration;
use dermis_touch::{Contact, Observation};
use dermis_twin::Frontend;
use dermis_twin::instrument::Instrument;
use dermis_twin::mechanics::{Indenter, Load, Shape};

use crate::Error;
use crate::report::ImagePanel;
use dermis_live::imager::Imager;
use dermis_live::prepare::Prepared;
use dermis_live::reconstructor::Reconstructor;
use dermis_live::reference::Reference;
use dermis_skin::Skin;
use dermis_twin::TwinKit;

/// Standard gravity, m/s^2.
const GRAVITY: f64 = 9.806_65;

/// Weight of a mass, newtons.
pub fn grams_n(grams: f64) -> f64 {
    grams * 1e-3 * GRAVITY
}

/// Frames at rest in a baseline.
const BASELINE_FRAMES: usize = 100;

/// A twin, its instrument, and what is needed to image its readings.
#[derive(Debug)]
pub struct Rig {
    prepared: Prepared,
    frontend: Box<dyn Frontend>,
    instrument: Instrument,
    frame_s: f64,
    reference: Reference,
    reconstructor: Reconstructor,
    frames: u64,
}

impl Rig {
    /// The twin of a built-in skin, with a baseline of 100 frames at rest.
    ///
    /// # Errors
    /// The skin has no twin, or the twin cannot be built.
    pub fn new(skin_name: &str) -> Result<Self, Error> {
        Self::of(Skin::open(skin_name)?)
    }

    /// Like [`Rig::new`], for any skin.
    ///
    /// # Errors
    /// As for [`Rig::new`].
    pub fn of(skin: Skin) -> Result<Self, Error> {
        let kit = TwinKit::of(&skin)?;
        let (frontend, instrument, _) = kit.twin.into_parts();
        Self::from_parts(skin, frontend, instrument)
    }

    /// A rig with a custom frontend and instrument.
    ///
    /// # Errors
    /// As for [`Rig::new`].
    pub fn from_parts(
        mut skin: Skin,
        mut frontend: Box<dyn Frontend>,
        mut instrument: Instrument,
    ) -> Result<Self, Error> {
        // Every frame counts by itself, because presses are held still and averaged here.
        skin.touch.least_frames = 1;
        let frame_s = 1.0 / skin.backend.frame_rate_hz();
        let prepared = Prepared::new(skin)?;
        let rest = read(&mut frontend, &mut instrument, &[], BASELINE_FRAMES, frame_s)?;
        let reference = Reference::of(&prepared, &rest)?;
        let data: Vec<Vec<f64>> = rest.iter().map(|frame| reference.difference(frame, None)).collect();
        let imager = Imager::new(&prepared, &reference, &data)?;
        let mut reconstructor = Reconstructor::offline(&prepared, &reference.noise, imager, None, None)?;
        reconstructor.take_reference(&prepared, &reference);
        Ok(Self { frontend, instrument, prepared, frame_s, reference, reconstructor, frames: 0 })
    }

    /// The skin's model.
    pub fn prepared(&self) -> &Prepared {
        &self.prepared
    }

    /// The reference for differences.
    pub fn reference(&self) -> &Reference {
        &self.reference
    }

    /// Image noise of each pixel.
    pub fn noise_image(&self) -> Vec<f32> {
        self.reconstructor.imager.noise_image()
    }

    /// Seconds between frames.
    pub fn frame_s(&self) -> f64 {
        self.frame_s
    }

    /// Reads consecutive frames under these indenters.
    ///
    /// # Errors
    /// A load is off the skin or larger than it, or the fields cannot be solved.
    pub fn frames(&mut self, indenters: &[Indenter], count: usize) -> Result<Vec<Vec<f64>>, Error> {
        read(&mut self.frontend, &mut self.instrument, indenters, count, self.frame_s)
    }

    /// Mean of `count` frames under these indenters, after one for the mechanics to settle.
    ///
    /// # Errors
    /// As for [`Rig::frames`].
    pub fn mean_frame(&mut self, indenters: &[Indenter], count: usize) -> Result<Vec<f64>, Error> {
        let frames = self.frames(indenters, count)?;
        let channels = self.prepared.channels();
        Ok((0..channels).map(|c| frames.iter().map(|frame| frame[c]).sum::<f64>() / count as f64).collect())
    }

    /// Takes frames under these indenters as the new baseline, so that this load no longer shows.
    ///
    /// # Errors
    /// As for [`Rig::frames`].
    pub fn tare(&mut self, indenters: &[Indenter]) -> Result<(), Error> {
        let frames = self.frames(indenters, BASELINE_FRAMES)?;
        self.reference = Reference::of(&self.prepared, &frames)?;
        Ok(())
    }

    /// The image of a frame: row-major, NaN outside the skin.
    ///
    /// # Errors
    /// The frame has the wrong length.
    pub fn image(&mut self, frame: &[f64]) -> Result<Vec<f32>, Error> {
        let mut image = vec![f32::NAN; self.prepared.map.grid().len()];
        self.reconstructor.image(&self.reference.difference(frame, None), &mut image)?;
        Ok(image)
    }

    /// Travel of the elements in the last image, if it was solved for.
    pub fn heights(&self) -> Option<&LiftOffFit> {
        self.reconstructor.imager.heights()
    }

    /// Sets another reference for differences.
    pub fn set_reference(&mut self, reference: Reference) {
        self.reference = reference;
    }

    /// Spread of an image around a place: root mean square distance weighted by the squared values, millimetres.
    pub fn spread_mm(&self, image: &[f32], [x, y]: Point) -> f64 {
        let columns = self.columns();
        let finite = image.iter().enumerate().filter(|(_, value)| value.is_finite());
        let (moment, total) = finite.fold((0.0, 0.0), |(moment, total), (index, value)| {
            let (at, weight) = (self.pixel_m(index, columns), f64::from(*value).powi(2));
            (moment + weight * ((at[0] - x).powi(2) + (at[1] - y).powi(2)), total + weight)
        });
        1e3 * (moment / total).sqrt()
    }

    /// Touches of the last image ([`Rig::image`]), treated as independent of the previous one, strongest first.
    ///
    /// # Errors
    /// The image has the wrong size.
    pub fn touches(&mut self, image: &[f32]) -> Result<Vec<Contact>, Error> {
        self.frames += 1;
        let time_ns = self.frames * 1_000_000_000;
        self.reconstructor.forget(time_ns);
        self.reconstructor.follow_touches(time_ns, image, None)?;
        let stage = &self.reconstructor.touches;
        let begun = stage.touches().iter().filter(|touch| touch.observation != Observation::Missed).count();
        Ok(stage.contacts().iter().take(begun).copied().collect())
    }

    /// Sets or removes the calibration that gives touches their forces.
    ///
    /// # Errors
    /// As [`Reconstructor::set_forces`].
    pub fn set_forces(&mut self, forces: Option<ForceCalibration>) -> Result<(), Error> {
        Ok(self.reconstructor.set_forces(forces)?)
    }

    /// Estimates forces by the layer's law for a round indenter of this radius, metres.
    ///
    /// # Errors
    /// As [`Reconstructor::set_indenter`].
    pub fn set_indenter(&mut self, radius_m: f64) -> Result<(), Error> {
        Ok(self.reconstructor.set_indenter(Some(radius_m))?)
    }

    /// An image panel with the indenters' positions marked.
    pub fn panel(&self, name: impl Into<String>, values: &[f32], places_m: &[Point]) -> ImagePanel {
        panel_of(&self.prepared, name, values, places_m)
    }

    /// Pixels per row of an image.
    pub fn columns(&self) -> usize {
        self.prepared.map.grid().columns
    }

    /// Position and value of the largest pixel.
    pub fn peak(&self, image: &[f32]) -> ([f64; 2], f64) {
        let grid = self.prepared.map.grid();
        let finite = image.iter().enumerate().filter(|(_, value)| value.is_finite());
        let (index, value) = finite.max_by(|a, b| a.1.total_cmp(b.1)).map_or((0, 0.0), |(k, v)| (k, f64::from(*v)));
        (self.pixel_m(index, grid.columns), value)
    }

    fn pixel_m(&self, index: usize, columns: usize) -> [f64; 2] {
        let grid = self.prepared.map.grid();
        let (column, row) = ((index % columns) as f64 + 0.5, (index / columns) as f64 + 0.5);
        [grid.left_m + column * grid.pixel_m, grid.top_m - row * grid.pixel_m]
    }

    /// Mean of the image over the 3 x 3 pixels around a place, fewer at a rim.
    pub fn mean_around(&self, image: &[f32], [x, y]: Point) -> f64 {
        let grid = self.prepared.map.grid();
        let column = ((x - grid.left_m) / grid.pixel_m).floor() as i64;
        let row = ((grid.top_m - y) / grid.pixel_m).floor() as i64;
        let mut values = Vec::with_capacity(9);
        for (r, c) in (row - 1..=row + 1).flat_map(|r| (column - 1..=column + 1).map(move |c| (r, c))) {
            if (0..grid.rows as i64).contains(&r) && (0..grid.columns as i64).contains(&c) {
                values.extend(Some(image[r as usize * grid.columns + c as usize]).filter(|v| v.is_finite()));
            }
        }
        values.iter().map(|v| f64::from(*v)).sum::<f64>() / values.len().max(1) as f64
    }
}

/// An image panel of a skin, with places marked.
pub(super) fn panel_of(prepared: &Prepared, name: impl Into<String>, values: &[f32], places_m: &[Point]) -> ImagePanel {
    let grid = prepared.map.grid();
    let (width, height) = (grid.columns as f64 * grid.pixel_m, grid.rows as f64 * grid.pixel_m);
    let share = |p: &Point| [(p[0] - grid.left_m) / width, (grid.top_m - p[1]) / height];
    let bend = match prepared.skin.surface() {
        Surface::Cylinder { radius_m } => Some(radius_m / width),
        Surface::Flat => None,
    };
    let marks = places_m.iter().map(share).collect();
    let (quantity, width_mm) = (prepared.skin.modality.image_quantity(), Some(1e3 * width));
    ImagePanel { name: name.into(), quantity, values: values.to_vec(), marks, bend, width_mm }
}

/// A round weight or indenter.
pub(super) fn disc(centre_m: Point, diameter_mm: f64, force_n: f64) -> Indenter {
    Indenter { centre_m, shape: Shape::Disc { radius_m: 0.5e-3 * diameter_mm }, load: Load::ForceN(force_n) }
}

/// Distance between two places, millimetres.
pub(super) fn distance_mm(a: [f64; 2], b: [f64; 2]) -> f64 {
    1e3 * distance(a, b)
}

fn read(
    frontend: &mut Box<dyn Frontend>,
    instrument: &mut Instrument,
    indenters: &[Indenter],
    count: usize,
    frame_s: f64,
) -> Result<Vec<Vec<f64>>, Error> {
    // A load that the skin cannot bear would be dropped silently, and the experiment would measure nothing.
    indenters.iter().try_for_each(|indenter| frontend.check_indenter(indenter))?;
    let mut frames = Vec::with_capacity(count);
    for _ in 0..count {
        let mut frame = vec![0.0; frontend.channel_count()];
        frontend.voltages(indenters, frame_s, &mut frame)?;
        instrument.read(frame_s, &mut frame);
        frames.push(frame);
    }
    Ok(frames)
}
