//! The presses that explain a frame: present ones, and those that have ended.

use dermis_estimate::{Estimate, Memory};

use super::{EXPLAINED, SpotStage};
use crate::stages::touch_search::{AT_ONCE, Asked, Explained, Patience, Searched, TouchSearch};

impl SpotStage {
    /// The presses that explain a frame.
    pub(super) fn explain(&mut self, difference: &[f64]) -> Explained {
        if let Some(rest) = self.explain_without_gone(difference) {
            self.learn_positions(&rest.presses);
            return Explained::By(rest, true);
        }
        let Some(estimate) = self.estimator.explain(difference, &self.hints) else { return Explained::Nothing };
        if self.estimator.is_out_of_work() {
            return Explained::Later(Some(estimate));
        }
        if self.is_outstanding && !self.is_joint {
            // A hard press leaves much that would pass for presses that have ended.
            self.ended.forget();
            return self.concluded(estimate, None);
        }
        if !self.ended.looks_for(&estimate) {
            return self.concluded(estimate, None);
        }
        let with_gone = self.estimator.explain_with_gone();
        if self.estimator.is_out_of_work() {
            return Explained::Later(Some(estimate));
        }
        self.concluded(estimate, Some(with_gone))
    }

    /// True if a search is under way, or none has explained the last frames.
    pub(crate) fn is_unsure(&self) -> bool {
        self.search.is_under_way() || self.pause.has_begun()
    }

    /// True if presses explain a frame for the most part. The next explanation starts from them. If finding them takes
    /// longer than following those of the last frame, the answer is no, and the next frames know it.
    pub(crate) fn explains(&mut self, time_ns: u64, difference: &[f64]) -> bool {
        self.due = self.searched(time_ns);
        if self.due.is_some() && self.found.is_empty() {
            return false;
        }
        let is_slow = self.is_joint && !self.is_unhurried;
        if is_slow {
            // The work for frames that were not shown doesn't count.
            self.estimator.spent_ns();
            self.estimator.allow(AT_ONCE);
        }
        let memory = self.estimator.memory().clone();
        let explained =
            if is_slow { self.estimator.follow(difference) } else { self.estimator.explain(difference, &[]) };
        let is_explained = explained.is_some_and(|e| !e.presses.is_empty() && e.unexplained <= EXPLAINED);
        if is_explained {
            return true;
        }
        if is_slow && !self.search.is_under_way() {
            self.search(time_ns, difference, memory.clone());
        }
        self.estimator.set_memory(memory);
        false
    }

    /// Explains a frame in the background, with this memory of the frames before it.
    pub(super) fn search(&mut self, time_ns: u64, difference: &[f64], memory: Memory) {
        let (frame, hints, is_gone_possible) = (difference.to_vec(), self.hints.clone(), self.ended.is_due());
        self.is_search_stale = false;
        self.is_search_of_contacts = !self.hints.is_empty();
        self.begin(Asked { time_ns, frame, memory, hints, is_gone_possible }, Patience::Short);
    }

    fn begin(&mut self, asked: Asked, patience: Patience) {
        let Some(estimator) = self.estimator.copy() else { return };
        let due_ns = asked.time_ns.saturating_add(patience.delay_ns());
        let search = TouchSearch { estimator, asked, patience };
        self.search.begin(due_ns, move |_| Some(search.run()));
    }

    /// The result of a search in the background, once it is due. A short search that did not suffice is followed by a
    /// longer one. The presses found by then are followed until that is due.
    pub(super) fn searched(&mut self, time_ns: u64) -> Option<Explained> {
        if self.due.is_some() {
            return self.due.take();
        }
        let searched = self.search.take(time_ns).filter(|_| !self.is_search_stale)?;
        let Searched { mut estimate, with_gone, memory, goes_on } = searched;
        let is_final = goes_on.is_none();
        if let Some(asked) = goes_on {
            self.begin(asked, Patience::Long);
            estimate = Some(estimate.filter(|estimate| self.is_accepted(estimate))?);
        }
        self.estimator.set_memory(memory);
        let Some(estimate) = estimate else { return Some(Explained::Nothing) };
        let explained = if is_final {
            let looks_for_gone = self.ended.looks_for(&estimate);
            self.concluded(estimate, with_gone.filter(|_| looks_for_gone))
        } else {
            Explained::By(estimate, false)
        };
        if let Explained::By(estimate, false) = &explained
            && self.is_accepted(estimate)
        {
            self.found.clone_from(&estimate.presses);
        }
        Some(explained)
    }

    /// The explanation of a frame from that by present presses and, if they were looked for, that by presses that have
    /// ended as well.
    pub(super) fn concluded(&mut self, estimate: Estimate, with_gone: Option<Option<Estimate>>) -> Explained {
        self.learn_positions(&estimate.presses);
        match with_gone.and_then(|with_gone| self.ended.judge(&estimate, with_gone)) {
            Some(rest) => Explained::By(rest, true),
            None => Explained::By(estimate, false),
        }
    }

    /// Between searches, takes the presses that the last one found to have ended off the frame and explains the rest.
    /// `None` without any, or if that no longer explains the frame.
    pub(super) fn explain_without_gone(&mut self, difference: &[f64]) -> Option<Estimate> {
        if !self.ended.is_between_searches() {
            return None;
        }
        if !self.estimator.is_at_rest(difference) {
            self.estimator.fit_mut().channels_of(&self.ended.presses, &mut self.volts);
            let rest: Vec<f64> = difference.iter().zip(&self.volts).map(|(all, gone)| all - gone).collect();
            let estimate = self.estimator.explain(&rest, &self.hints)?;
            let energy = |volts: &[f64]| volts.iter().map(|volts| volts * volts).sum::<f64>();
            if self.ended.explain(estimate.unexplained * energy(&rest) / energy(difference), &estimate) {
                return Some(estimate);
            }
        }
        self.ended.drop_presses();
        None
    }
}
