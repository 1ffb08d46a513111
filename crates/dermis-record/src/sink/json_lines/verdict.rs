//! A guard's verdict.

use dermis_touch::guard::{GuardReasons, GuardReport};
use serde::{Serialize, Serializer};

/// The verdict of a guard on a frame.
#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub(crate) struct Verdict {
    /// `ok`, `stale` or `stop`.
    verdict: &'static str,
    /// Its reasons; none if it is `ok`.
    #[cfg_attr(test, schemars(with = "Vec<String>"))]
    reasons: Reasons,
    /// Always false.
    safety_rated: bool,
}

impl Verdict {
    pub(crate) fn of(report: &GuardReport) -> Self {
        Self { verdict: report.verdict.name(), reasons: Reasons(report.reasons), safety_rated: false }
    }
}

struct Reasons(GuardReasons);

impl Serialize for Reasons {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.0.iter().map(|reason| reason.name()))
    }
}
