//! Model error in the positions of touches, which adds to noise. Part of it is the same for every skin with the same
//! kind of layer, and was measured on twins; a fit of spots estimates the rest from its residual.

use dermis_estimate::Press;
use dermis_skin::Layer;
use dermis_tomo::mesh::Outline;
use dermis_touch::Contact;

use crate::prepare::Prepared;
use crate::stages::plates::{coarseness, element_m, fits_contacts};

/// Error of touches that only the image places, and of touches in frames that their fit doesn't explain: a share of
/// half the shorter side, as one sigma per coordinate. The skin file can override it.
const BY_IMAGE: f64 = 0.015;
/// Error of presses on elements over coils, in cells: first for touches placed at the centroid of their forces, then
/// for touches that a fit has placed.
const ELEMENTS_CELLS: f64 = 0.07;
const REFINED_ELEMENTS_CELLS: f64 = 0.01;

/// Position error of touches that a fit has placed, one sigma per coordinate.
#[derive(Clone, Copy, Debug)]
struct Refined {
    everywhere: f64,
    /// Additional error near the rim: constant up to a distance of `within`, then falling by a factor of e with each
    /// `fades`.
    at_rim: f64,
    within: f64,
    fades: f64,
}

/// Number of electrodes from which model errors of liquids grow, with the square of the number: on twins of three
/// liquids with 32, the error near the rim was 0.004 to 0.006 of half the shorter side.
const CLOSE_ELECTRODES: f64 = 16.0;
/// Liquids under a membrane, which spreads the load; in shares of half the shorter side. The error at the rim is that
/// of 16 electrodes.
const MEMBRANE: Refined = Refined { everywhere: 0.0004, at_rim: 0.0014, within: 0.21, fades: 0.15 };
/// Sandwiches, in shares of half the shorter side.
const SANDWICH: Refined = Refined { everywhere: 0.0005, at_rim: 0.0007, within: 0.24, fades: 0.04 };
/// Contacts with patches, in sizes of the elements for fits: 0.04 to 0.14 on twins of ten skins.
const CONTACTS: f64 = 0.1;
/// Smooth spots on patches, in pitches. A patch conducts as a whole, and the rim cuts some of them.
const PATCHES: Refined = Refined { everywhere: 0.115, at_rim: 0.096, within: 1.4, fades: 0.1 };
/// Sheets, near the rim in radii of the touch: pixels that the rim cuts are only roughly right. On twins of 22 gels and
/// foams it was 0 to 0.03 within two radii of the rim, and nothing beyond them.
const SHEET_AT_RIM: Refined = Refined { everywhere: 0.0, at_rim: 0.016, within: 2.6, fades: 0.6 };
/// Open tanks, in shares of half the shorter side, and near the wall in radii of the touch. The surface takes the shape
/// of the indenter, which has a sharper edge than a spot.
const TANK_EVERYWHERE: f64 = 0.0005;
const TANK_AT_WALL: Refined = Refined { everywhere: 0.0, at_rim: 0.2, within: 2.0, fades: 0.5 };

/// Position error of a touch that isn't shaped like a spot, in its radii, per square root of the share of the frame's
/// energy that the fit leaves unexplained.
const OF_SHAPE: f64 = 1.0;

impl Refined {
    /// Multiplies all lengths by the size of the unit that they are given in.
    fn times(self, unit: f64) -> Self {
        let Self { everywhere, at_rim, within, fades } = self;
        Self { everywhere: unit * everywhere, at_rim: unit * at_rim, within: unit * within, fades: unit * fades }
    }

    /// Multiplies the errors.
    fn multiplied(self, factor: f64) -> Self {
        Self { everywhere: factor * self.everywhere, at_rim: factor * self.at_rim, ..self }
    }

    /// Variance at a distance from the rim.
    fn variance(self, from_rim: f64) -> f64 {
        let beyond = (from_rim - self.within).max(0.0);
        self.everywhere.powi(2) + (self.at_rim * (-beyond / self.fades).exp()).powi(2)
    }
}

/// Variance of each coordinate of a touch due to model error, square metres.
#[derive(Debug)]
pub(super) struct ModelError {
    /// For touches that only the image places.
    by_image_m2: f64,
    refined: OfRefined,
}

/// For touches that a fit has placed.
#[derive(Debug)]
enum OfRefined {
    /// The same for all, m^2.
    Alike(f64),
    /// Depends on the position; lengths in metres.
    ByPlace(Outline, Refined),
    /// Depends on position and radius, with lengths in radii.
    ByRadius {
        outline: Outline,
        of_radius: Refined,
        /// Variance common to all, m^2.
        everywhere_m2: f64,
    },
}

impl ModelError {
    pub fn of(prepared: &Prepared) -> Self {
        let (skin, half_width_m) = (&prepared.skin, prepared.half_width_m());
        let both = |error_m: f64| Self { by_image_m2: error_m.powi(2), refined: OfRefined::Alike(error_m.powi(2)) };
        if let Some(error_mm) = skin.touch.model_error_mm {
            return both(1e-3 * error_mm);
        }
        let by_image = both(BY_IMAGE * half_width_m);
        let by_place = |refined: Refined, unit_m: f64| OfRefined::ByPlace(skin.outline(), refined.times(unit_m));
        let by_radius = |of_radius: Refined, everywhere_m: f64| OfRefined::ByRadius {
            outline: skin.outline(),
            of_radius,
            everywhere_m2: everywhere_m.powi(2),
        };
        let refined = match &skin.frontend.layer {
            Layer::Elements(_) => {
                let cell_m = skin.frontend.elements.as_ref().map(|elements| elements.cell_m());
                return cell_m.map_or(by_image, |[x, y]| Self {
                    refined: OfRefined::Alike((REFINED_ELEMENTS_CELLS * x.max(y)).powi(2)),
                    ..both(ELEMENTS_CELLS * x.max(y))
                });
            }
            _ if !skin.fits_touches() => return by_image,
            Layer::Sandwich(_) => by_place(SANDWICH.multiplied(coarseness(skin)), half_width_m),
            layer if layer.is_open_tank() => by_radius(TANK_AT_WALL, TANK_EVERYWHERE * half_width_m),
            Layer::Sheet(_) => by_radius(SHEET_AT_RIM, 0.0),
            Layer::Liquid(_) => {
                let close = (skin.electrode_shapes().len() as f64 / CLOSE_ELECTRODES).max(1.0).powi(2);
                by_place(Refined { at_rim: close * MEMBRANE.at_rim, ..MEMBRANE }, half_width_m)
            }
            Layer::Patches(_) if fits_contacts(prepared) => OfRefined::Alike((CONTACTS * element_m(skin)).powi(2)),
            Layer::Patches(layer) => by_place(PATCHES, 1e-3 * layer.pitch_mm),
        };
        Self { refined, ..by_image }
    }

    /// Variance in addition to the fit's estimate of its own error, m^2. Only fitted touches have a radius.
    pub fn variance_m2(&self, contact: &Contact) -> f64 {
        let Some(radius_m) = contact.radius_m else { return self.by_image_m2 };
        match &self.refined {
            OfRefined::Alike(variance_m2) => *variance_m2,
            OfRefined::ByPlace(outline, refined) => refined.variance(outline.inside_by_m(contact.centroid_m)),
            OfRefined::ByRadius { outline, of_radius, everywhere_m2 } => {
                everywhere_m2 + of_radius.times(radius_m).variance(outline.inside_by_m(contact.centroid_m))
            }
        }
    }
}

/// Variance of each coordinate of a spot in addition to its covariance, m^2. `unexplained` is the share of the frame's
/// energy above the noise that the fit leaves.
pub(super) fn shape_variance_m2(press: &Press, unexplained: f64) -> f64 {
    (OF_SHAPE * press.radius_m).powi(2) * unexplained
}

#[cfg(test)]
mod tests {
    use super::*;
    use dermis_skin::Skin;

    fn sigma_mm(error: &ModelError, x_mm: f64, radius_mm: Option<f64>) -> f64 {
        let radius_m = radius_mm.map(|mm| 1e-3 * mm);
        let contact = Contact { radius_m, ..Contact::even([1e-3 * x_mm, 0.0], 1.0, 1e-4) };
        1e3 * error.variance_m2(&contact).sqrt()
    }

    #[test]
    fn errors_follow_the_layer_and_grow_towards_the_rim() {
        let of = |name: &str, x_mm: f64, radius_mm| {
            let prepared = Prepared::new(Skin::open(name).unwrap()).unwrap();
            sigma_mm(&ModelError::of(&prepared), x_mm, radius_mm)
        };
        let near = |a: f64, b: f64| assert!((a / b - 1.0).abs() < 1e-6, "{a} {b}");
        // Half the shorter side is 87 mm. 4 mm from the rim is near it.
        let fading = (-(1.0_f64 - 0.21) / 0.15).exp();
        near(of("ionic-disc", 0.0, Some(4.0)), 0.087 * 0.4_f64.hypot(1.4 * fading));
        near(of("ionic-disc", 83.0, Some(4.0)), 0.087 * 0.4_f64.hypot(1.4));
        near(of("ionic-disc", 0.0, None), 1.305);
        // A tank of 200 mm: near its wall, the error is proportional to the touch's radius.
        near(of("pyeidors-tank", 0.0, Some(5.0)), 0.05);
        near(of("pyeidors-tank", 95.0, Some(5.0)), 0.05_f64.hypot(1.0));
        // A pitch of 10 mm.
        near(of("piezo-square", 0.0, Some(5.0)), 1.15);
        near(of("piezo-square", 70.0, Some(5.0)), 1.15_f64.hypot(0.96));
        // A cell of 35 mm.
        near(of("em-16-square", 0.0, None), 0.07 * 35.0);
        near(of("em-16-square", 0.0, Some(9.0)), 0.01 * 35.0);
        // An error stated in the file applies everywhere.
        let mut skin = Skin::open("ionic-disc").unwrap();
        skin.touch.model_error_mm = Some(2.0);
        let told = ModelError::of(&Prepared::new(skin).unwrap());
        assert!([None, Some(4.0)].iter().all(|radius| sigma_mm(&told, 83.0, *radius) == 2.0));
    }
}
