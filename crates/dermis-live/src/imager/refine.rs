//! Offline images of large contrasts: Gauss-Newton steps in log conductivity on the same mesh, weights, prior and
//! lambda as the live image ([`dermis_tomo::inverse::NonlinearProblem`]), with frames in parallel.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::mpsc;

use dermis_skin::Refinement;
use dermis_tomo::inverse::{GaussNewton, NonlinearProblem, ReducedChannels};
use rayon::prelude::*;

use super::weighting::{prior_matrix, weighting};
use crate::Error;
use crate::prepare::Prepared;
use crate::reference::Reference;

/// Refines frames of one skin against one reference.
#[derive(Debug)]
pub struct Refiner {
    pub(super) problem: NonlinearProblem,
    parameters: GaussNewton,
    pub(super) polarity: f64,
    pub(super) pixels: usize,
    pub(super) inside: Vec<u32>,
    /// Reduced data for each set of missing channels seen.
    pub(super) reduced: HashMap<Vec<u32>, ReducedChannels>,
}

/// Maximum number of sets of missing channels that are cached (each takes some 10 MB with 32 electrodes).
const MOST_SETS: usize = 16;

impl Refiner {
    /// A refiner with the skin file's settings, at a live image's lambda.
    ///
    /// # Errors
    /// Weights that the reference cannot provide, or a body that cannot be solved.
    pub fn new(
        prepared: &Prepared,
        refinement: &Refinement,
        reference: &Reference,
        lambda: f64,
    ) -> Result<Self, Error> {
        let weighting = weighting(prepared, reference)?;
        let prior = prior_matrix(prepared, &weighting)?;
        let (body, conductance) = (prepared.body.mesh.clone(), prepared.skin.sheet_conductance_s());
        let problem = NonlinearProblem::new(body, &prepared.protocol, &prepared.map, conductance, &weighting, &prior)?;
        let parameters = GaussNewton {
            steps: refinement.steps,
            hyperparameter: lambda,
            largest_step: refinement.largest_step,
            limit: refinement.limit,
        };
        let polarity = prepared.skin.imaging.polarity.sign();
        let (pixels, inside) = (prepared.map.grid().len(), prepared.map.inside_pixels().to_vec());
        Ok(Self { problem, parameters, polarity, pixels, inside, reduced: HashMap::new() })
    }

    /// Images of difference frames (model volts, `NaN` where missing): for each frame a row-major image of
    /// `log(sigma / sigma at rest)`, polarity included, `NaN` outside. `step_done` is called once for every step of
    /// every frame.
    ///
    /// # Errors
    /// All channels missing, or a forward problem that cannot be solved.
    pub fn images(&mut self, differences: &[Vec<f64>], mut step_done: impl FnMut()) -> Result<Vec<Vec<f32>>, Error> {
        self.reduce(differences)?;
        let (this, (done, steps)) = (&*self, mpsc::channel());
        std::thread::scope(|scope| {
            let worker = scope.spawn(|| {
                let image = |done: &mut mpsc::Sender<()>, frame: &Vec<f64>| {
                    // The receiver lives as long as this scope, and a lost progress report would not matter.
                    let report = |_| {
                        let _ = done.send(());
                    };
                    let channels = &this.reduced[&absent(frame)];
                    let result = this.problem.solve(&this.parameters, channels, frame, report)?;
                    let mut image = vec![f32::NAN; this.pixels];
                    for (&pixel, &value) in this.inside.iter().zip(&result.log_conductivity) {
                        image[pixel as usize] = (this.polarity * value) as f32;
                    }
                    Ok(image)
                };
                differences.par_iter().map_with(done, image).collect::<Result<Vec<_>, Error>>()
            });
            steps.iter().for_each(|()| step_done());
            worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        })
    }

    /// Computes one reduction for each set of missing channels.
    pub(super) fn reduce(&mut self, differences: &[Vec<f64>]) -> Result<(), Error> {
        if self.reduced.len() >= MOST_SETS {
            self.reduced.clear();
        }
        for frame in differences {
            if let Entry::Vacant(place) = self.reduced.entry(absent(frame)) {
                let reduced = self.problem.reduce(place.key())?;
                place.insert(reduced);
            }
        }
        Ok(())
    }
}

pub(super) fn absent(frame: &[f64]) -> Vec<u32> {
    frame.iter().enumerate().filter(|(_, v)| !v.is_finite()).map(|(channel, _)| channel as u32).collect()
}
