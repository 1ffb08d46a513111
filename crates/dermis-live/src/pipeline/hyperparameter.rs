//! Images at another lambda: the operator is built in the background, and used when it is due.

use dermis_tomo::inverse::check_hyperparameter;

use super::Pipeline;
use super::state::State;
use crate::Error;
use crate::reconstructor::Reconstructor;

/// Delay until an operator for another lambda is used, nanoseconds of the frames' time: several times what it takes
/// to build one on one slow core.
const OPERATOR_READY_NS: u64 = 300_000_000;

impl Pipeline {
    /// Requests images at another lambda. The operator is built in the background and used 0.3 seconds of the frames'
    /// time later. If several are requested meanwhile, the last is built next. If one cannot be built, because lambda
    /// is too small, this is logged and the previous one stays. Before the first baseline, lambda is stored until
    /// then. If a circuit is found later, it stays the same multiple of the lambda of the skin file's rule.
    ///
    /// # Errors
    /// A lambda that is not positive and finite.
    pub fn set_hyperparameter(&mut self, lambda: f64) -> Result<(), Error> {
        // Before the start it is only stored, so an invalid value must be reported now.
        check_hyperparameter(lambda)?;
        self.choices.hyperparameter = Some(lambda);
        if self.operators.making.is_some() {
            self.operators.next = Some(lambda);
        } else if self.hyperparameter().is_some_and(|in_use| in_use != lambda) {
            self.make_operator(lambda);
        }
        Ok(())
    }

    /// Starts building the operator at another lambda.
    pub(super) fn make_operator(&mut self, lambda: f64) {
        let State::Running(running) = &self.state else { return };
        let work = running.reconstructor.imager.work_out(lambda);
        let due_ns = self.timing.clock.time_ns().saturating_add(OPERATOR_READY_NS);
        self.operators.making = Some(lambda);
        self.operators.coming.begin(due_ns, move |_| Some(work()));
    }

    /// Switches to an operator that was built, if it is due.
    pub(super) fn take_up_operator(&mut self, time_ns: u64) -> Result<(), Error> {
        let Some(made) = self.operators.coming.take(time_ns) else { return Ok(()) };
        let lambda = self.operators.making.take().unwrap_or(f64::NAN);
        let State::Running(running) = &mut self.state else { return Ok(()) };
        let Reconstructor { imager, touches, .. } = &mut running.reconstructor;
        match made.and_then(|operator| imager.replace_operator(operator, &running.reference.noise)) {
            Ok(()) => {
                touches.set_noise(imager.noise_image());
                if let Some(damage) = &mut self.damage {
                    damage.set_noise(imager.noise_image());
                }
                if let Some(levels) = &mut self.levels {
                    levels.set_noise(imager.noise_image());
                }
                self.compare_with_reference()?;
            }
            Err(error) => {
                let in_use = imager.hyperparameter();
                tracing::warn!(
                    "the hyperparameter {lambda:.3e} cannot be used ({error}); continuing with {in_use:.3e}"
                );
                self.choices.hyperparameter = Some(in_use);
            }
        }
        if let Some(next) = self.operators.next.take().filter(|next| Some(*next) != self.hyperparameter()) {
            self.make_operator(next);
        }
        Ok(())
    }
}
