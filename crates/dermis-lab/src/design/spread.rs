//! The width of a point in the image: the point-spread width of the skin's own operator.

use dermis_live::imager::Imager;
use dermis_live::reference::Reference;
use dermis_tomo::mesh::distance;
use dermis_tomo::quality::spread_width_m;

use super::maps::Maps;
use crate::Error;
use dermis_live::prepare::Prepared;

/// Width of a point's image at each place of the maps, metres.
///
/// This is the diameter of a disc with the area of the region at half the peak or more (the resolution figure of
/// GREIT, Adler et al., Physiol. Meas. 30, 2009, S35, as a length). The point is one pixel of the skin's image grid;
/// the operator is the skin file's. NaN if the image has no peak of the right sign.
///
/// # Errors
/// The operator cannot be built from the model alone.
pub fn spread_width(prepared: &Prepared, maps: &Maps) -> Result<Vec<f64>, Error> {
    let reference = Reference::from_baseline(prepared, &prepared.voltages, None)?;
    let mut imager = Imager::new(prepared, &reference, &[prepared.signatures(&[[0.0, 0.0]])])?;
    let (grid, positions) = (prepared.map.grid(), &prepared.basis.positions);
    let polarity = prepared.skin.imaging.polarity.sign();
    let mut image = vec![f32::NAN; grid.len()];
    let mut widths = Vec::with_capacity(maps.places_m.len());
    for place_m in &maps.places_m {
        let away_m = |k: usize| distance([positions[k][0], positions[k][1]], *place_m);
        let nearest = (0..positions.len()).min_by(|&a, &b| away_m(a).total_cmp(&away_m(b)));
        let Some(pixel) = nearest else { continue };
        let point: Vec<f64> = (0..prepared.channels()).map(|c| polarity * prepared.jacobian.row(c)[pixel]).collect();
        imager.image(&point, &mut image)?;
        let values: Vec<f64> = image.iter().map(|value| f64::from(*value)).collect();
        widths.push(spread_width_m(&values, grid, 1.0).unwrap_or(f64::NAN));
    }
    Ok(widths)
}
