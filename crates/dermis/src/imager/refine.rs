//! Offline images of large contrasts: Gauss-Newton steps in log conductivity on the same mesh, weights, prior and lambda as
//! the live image ([`dermis_tomo::inverse::NonlinearProblem`]), frames in parallel.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::mpsc;

use dermis_tomo::inverse::{GaussNewton, NonlinearProblem, ReducedChannels};
use rayon::prelude::*;

use super::Imager;
use crate::Error;
use crate::prepare::Prepared;
use crate::reference::Reference;
use crate::skin::Refinement;

impl Prepared {
    /// Refines the images of difference frames (model volts, `NaN` where missing) as the skin file says: for each frame a
    /// row-major image of `log(sigma / sigma at rest)`, polarity included, `NaN` outside. lambda is the imager's.
    /// `step_done` is called once for every step of every frame.
    ///
    /// # Errors
    /// All channels missing, or a forward problem that cannot be solved.
    pub fn refine(
        &self,
        refinement: &Refinement,
        reference: &Reference,
        imager: &Imager,
        differences: &[Vec<f64>],
        mut step_done: impl FnMut(),
    ) -> Result<Vec<Vec<f32>>, Error> {
        let weighting = self.weighting(reference)?;
        let prior = self.prior_matrix(&weighting)?;
        let (body, conductance) = (self.body.mesh.clone(), self.skin.sheet_conductance_s());
        let problem = NonlinearProblem::new(body, &self.protocol, &self.map, conductance, &weighting, &prior)?;
        let parameters = GaussNewton {
            steps: refinement.steps,
            hyperparameter: imager.hyperparameter(),
            largest_step: refinement.largest_step,
            limit: refinement.limit,
        };
        let channels = reduced_channels(&problem, differences)?;
        let polarity = self.skin.imaging.polarity.sign();
        let (done, steps) = mpsc::channel();
        std::thread::scope(|scope| {
            let worker = scope.spawn(|| {
                let image = |done: &mut mpsc::Sender<()>, frame: &Vec<f64>| {
                    // The receiver lives as long as this scope; a progress report lost would not matter.
                    let report = |_| {
                        let _ = done.send(());
                    };
                    let result = problem.solve(&parameters, &channels[&absent(frame)], frame, report)?;
                    let mut image = vec![f32::NAN; self.map.grid().len()];
                    for (&pixel, &value) in self.map.inside_pixels().iter().zip(&result.log_conductivity) {
                        image[pixel as usize] = (polarity * value) as f32;
                    }
                    Ok(image)
                };
                differences.par_iter().map_with(done, image).collect::<Result<Vec<_>, Error>>()
            });
            steps.iter().for_each(|()| step_done());
            worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        })
    }
}

/// One reduction for each set of missing channels that occurs.
fn reduced_channels(
    problem: &NonlinearProblem<'_>,
    differences: &[Vec<f64>],
) -> Result<HashMap<Vec<u32>, ReducedChannels>, Error> {
    let mut known = HashMap::new();
    for frame in differences {
        if let Entry::Vacant(place) = known.entry(absent(frame)) {
            let reduced = problem.reduce(place.key())?;
            place.insert(reduced);
        }
    }
    Ok(known)
}

fn absent(frame: &[f64]) -> Vec<u32> {
    frame.iter().enumerate().filter(|(_, v)| !v.is_finite()).map(|(channel, _)| channel as u32).collect()
}
