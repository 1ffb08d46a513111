//! Touches on sheets, separate patches and liquids: the presses that explain a frame, converted to contacts.

mod explanation;

use dermis_estimate::{Anchor, BuiltVariance, Estimate, Estimator, Evidence, Press, PressFit};
use dermis_skin::Layer;
use dermis_tomo::mesh::{PixelGrid, Point, distance};
use dermis_touch::force::ForceReading;
use dermis_touch::{Contact, ContactStrength};

use crate::beside::Beside;
use crate::imager::{Imager, PartScratch};
use crate::prepare::Prepared;
use crate::stages::ended_presses::EndedPresses;
use crate::stages::ended_presses::Gone;
use crate::stages::force_law::ForceLaw;
use crate::stages::model_error::shape_variance_m2;
use crate::stages::pace::Pace;
use crate::stages::plates::fits_contacts;
use crate::stages::press_peaks::{Peaks, Remains};
use crate::stages::spot_model::{MOST_SPOTS, TYPICAL_RADIUS};
use crate::stages::touch_search::{AT_ONCE, Explained, InVain, Pause, Searched};
use crate::stages::touch_search::{doubt, is_outstanding};
use crate::stages::workshop_error::BuiltError;

/// Keep the image's contact in place of a press that leaves more than this share of its frame unexplained and is
/// further from the contact than this share of half the shorter side. On patches, whose edges the model doesn't know,
/// the distance is half a pitch.
const EXPLAINED: f64 = 0.05;
const FAR: f64 = 0.2;
const PATCHES_EXPLAINED: f64 = 0.01;
const FAR_PITCHES: f64 = 0.5;
/// Reject fits that leave more than this share of a frame's energy where images join presses: the skin has changed in
/// another way. The image's contacts then begin no touch.
const MOST_UNEXPLAINED: f64 = 0.3;
/// In a tank, a press below this share of the strongest is a side lobe of it.
const LOBE: f64 = 0.2;

/// Explains frames one after the other by presses, with its own working memory.
#[derive(Debug)]
pub(crate) struct SpotStage {
    estimator: Estimator,
    /// Presses are smooth spots, whose fit tells how far they are not. Patches conduct as a whole.
    are_smooth: bool,
    /// The largest share of a frame that a fit may leave unexplained above the noise.
    most_unexplained: f64,
    /// Weak presses are side lobes.
    is_tank: bool,
    both_signs: bool,
    /// Converts presses to forces, if the file states the layer's response.
    law: Option<ForceLaw>,
    polarity: f64,
    grid: PixelGrid,
    /// Index of each pixel among the image's unknowns; `None` outside.
    unknowns: Vec<Option<u32>>,
    typical_radius_m: f64,
    /// Errors of the model because the skin is not as drawn.
    built: Option<BuiltError>,
    /// Images join presses.
    is_joint: bool,
    /// See [`SpotStage::postpone`].
    is_postponed: bool,
    /// A search that takes longer than a frame.
    search: Beside<Searched>,
    /// Its result, if it was due before contacts were known.
    due: Option<Explained>,
    /// The presses that it found in an earlier frame, if that was due in this frame.
    found: Vec<Press>,
    /// The image showed contacts when it began, and has shown none since.
    is_search_of_contacts: bool,
    is_search_stale: bool,
    pause: Pause,
    in_vain: InVain,
    /// The frame over the noise of its channels.
    scaled: Vec<f64>,
    pace: Pace,
    explained: f64,
    far_m: f64,
    hints: Vec<Press>,
    /// The image's highest peak is much higher than its lowest value is deep.
    is_outstanding: bool,
    /// Contacts as found in the image.
    of_image: Vec<Contact>,
    /// The presses reported.
    shown: Vec<Press>,
    /// Positions and radii of presses from when the baseline was fresh.
    anchors: Vec<Anchor>,
    is_aged: bool,
    peaks: Peaks,
    /// Sets that past presses have left in the layer, to be added to the baseline.
    sets: Vec<Press>,
    ended: EndedPresses,
    is_unhurried: bool,
    volts: Vec<f64>,
    /// Presses and their channels, model volts.
    explained_part: (Vec<Press>, Vec<f64>),
    part: PartScratch,
}

impl SpotStage {
    /// A stage with responses of the prepared skin. `membrane_pa` is the pressure of a load of amplitude 1, if
    /// presses act through a membrane.
    pub(crate) fn new(prepared: &Prepared, fit: Box<dyn PressFit>, membrane_pa: Option<f64>) -> Self {
        let touch = &prepared.skin.touch;
        let grid = *prepared.map.grid();
        let mut unknowns = vec![None; grid.len()];
        for (unknown, &pixel) in (0..).zip(prepared.map.inside_pixels()) {
            unknowns[pixel as usize] = Some(unknown);
        }
        let pitch_m = match &prepared.skin.frontend.layer {
            Layer::Patches(layer) if !fits_contacts(prepared) => Some(1e-3 * layer.pitch_mm),
            _ => None,
        };
        let evidence = Evidence { begin: touch.begin_sigma, hold: touch.hold_sigma };
        let is_joint = fit.is_joint();
        let estimator = Estimator::new(fit, evidence, touch.both_signs);
        Self {
            is_joint,
            is_postponed: false,
            search: Beside::new(),
            due: None,
            found: Vec::new(),
            is_search_of_contacts: false,
            is_search_stale: false,
            pause: Pause::default(),
            in_vain: InVain::default(),
            scaled: Vec::new(),
            pace: Pace::default(),
            estimator,
            are_smooth: matches!(prepared.skin.frontend.layer, Layer::Liquid(_) | Layer::Sheet(_)),
            most_unexplained: touch.most_unexplained.min(if is_joint { MOST_UNEXPLAINED } else { 1.0 }),
            is_tank: touch.most_unexplained < 1.0,
            both_signs: touch.both_signs,
            law: ForceLaw::of(prepared, membrane_pa),
            polarity: prepared.skin.imaging.polarity.sign(),
            grid,
            unknowns,
            typical_radius_m: TYPICAL_RADIUS * prepared.half_width_m(),
            built: None,
            explained: if pitch_m.is_some() { PATCHES_EXPLAINED } else { EXPLAINED },
            far_m: pitch_m.map_or(FAR * prepared.half_width_m(), |pitch_m| FAR_PITCHES * pitch_m),
            hints: Vec::with_capacity(MOST_SPOTS),
            is_outstanding: false,
            of_image: Vec::with_capacity(MOST_SPOTS),
            shown: Vec::with_capacity(MOST_SPOTS),
            anchors: Vec::new(),
            is_aged: false,
            peaks: Peaks::default(),
            sets: Vec::new(),
            ended: EndedPresses::new(touch.both_signs, is_joint),
            is_unhurried: false,
            volts: Vec::new(),
            explained_part: Default::default(),
            part: PartScratch::default(),
        }
    }

    /// From now on, every frame is searched in full, within the usual bound on operations.
    pub(crate) fn take_time(&mut self) {
        self.is_unhurried = true;
        self.ended.take_time();
        self.estimator.take_time();
    }

    /// Accounts for the errors of a skin that is not as drawn.
    pub(crate) fn set_built(&mut self, built: Option<BuiltError>) {
        self.estimator.fit_mut().set_error_beyond(built.as_ref().map_or(0.0, BuiltError::unexplained));
        self.built = built;
    }

    /// Continues with a fit that weighs the channels differently, for a fresh or an aged baseline.
    pub(crate) fn set_fit(&mut self, fit: Box<dyn PressFit>, is_aged: bool) {
        if is_aged && !self.is_aged {
            self.anchors.iter_mut().for_each(Anchor::settle);
        }
        self.is_aged = is_aged;
        self.estimator.set_fit(fit);
        self.explained_part.0.clear();
        self.ended.presses.clear();
        self.set_built(self.built.clone());
    }

    /// The part of the last frame explained by the presses reported (model volts); `None` without any.
    pub(crate) fn explained(&mut self) -> Option<&[f64]> {
        if self.shown.is_empty() {
            return None;
        }
        let (of, volts) = &mut self.explained_part;
        if *of != self.shown {
            self.estimator.fit_mut().channels_of(&self.shown, volts);
            of.clone_from(&self.shown);
        }
        Some(volts)
    }

    /// True if presses are being followed.
    pub(crate) fn is_touched(&self) -> bool {
        !self.shown.is_empty()
    }

    /// Forgets the last frame: the next is unrelated to it.
    pub(crate) fn forget(&mut self) {
        self.estimator.forget();
        self.search.cancel();
        self.due = None;
        self.found.clear();
        self.pause = Pause::default();
        self.in_vain.clear();
        self.pace.forget();
        self.ended.forget();
        self.peaks = Peaks::default();
        self.anchors.clear();
        self.sets.clear();
    }

    /// States whether frames come from an instrument, which doesn't wait for searches.
    pub(crate) fn set_live(&mut self, is_live: bool) {
        self.search.set_live(is_live);
    }

    /// If the current frame needs a search, it is made in the background, because the frame has already taken long.
    /// Only where images join presses: other searches are quick.
    pub(crate) fn postpone(&mut self) {
        self.is_postponed = true;
    }

    /// Number of frames that had to wait for a search.
    pub(crate) fn waits(&self) -> u64 {
        self.search.waits()
    }

    /// Learns where presses are. Once the baseline has aged, they keep their positions and radii until they move.
    fn learn_positions(&mut self, presses: &[Press]) {
        let is_aged = self.is_aged;
        let is_kept = |anchor: &Anchor| is_aged && anchor.is_settled();
        self.anchors.retain(|anchor| presses.iter().any(|press| anchor.is_near(press)));
        for press in presses {
            match self.anchors.iter_mut().find(|anchor| anchor.is_near(press)) {
                Some(anchor) if !is_kept(anchor) => anchor.learn(press),
                Some(anchor) if anchor.press().position_m == press.position_m => {}
                Some(anchor) => *anchor = Anchor::at(press),
                None => self.anchors.push(Anchor::at(press)),
            }
        }
        self.estimator.keep(self.anchors.iter().filter(|anchor| is_kept(anchor)).map(Anchor::press));
    }

    /// Presses that are part of the baseline but have ended, once they have been missing for several frames.
    pub(crate) fn gone(&mut self) -> Option<Gone<'_>> {
        if !self.sets.is_empty() {
            self.estimator.fit_mut().channels_of(&self.sets, &mut self.volts);
            self.sets.clear();
            return Some(Gone::BesideOthers(&self.volts));
        }
        match self.ended.take_certain()? {
            [] => return Some(Gone::Alone),
            presses => self.estimator.fit_mut().channels_of(presses, &mut self.volts),
        }
        self.ended.presses.clear();
        Some(Gone::BesideOthers(&self.volts))
    }

    /// Replaces the contacts of an image by the presses that explain its frame (model volts). The image's contacts
    /// stay if the frame cannot be fitted, or if presses leave more of it unexplained than `touch.most_unexplained`.
    /// `noise` is that of the channels (model volts), `lowest` the lowest value of the image.
    pub(crate) fn refine(
        &mut self,
        time_ns: u64,
        difference: &[f64],
        noise: &[f64],
        imager: &Imager,
        lowest: f64,
        contacts: &mut Vec<Contact>,
    ) {
        if self.is_joint {
            let over = |(value, noise): (&f64, &f64)| if *noise > 0.0 { value / noise } else { 0.0 };
            self.scaled.clear();
            self.scaled.extend(difference.iter().zip(noise).map(over));
        }
        if self.is_unhurried && !self.is_joint {
            return self.refine_now(time_ns, difference, imager, lowest, contacts);
        }
        self.is_search_stale |= contacts.is_empty() && self.is_search_of_contacts;
        match self.searched(time_ns) {
            // This frame starts from the presses found.
            None => {}
            Some(Explained::By(estimate, false)) if self.is_accepted(&estimate) => {}
            Some(explained) => {
                self.show(time_ns, explained, imager, lowest, contacts);
                self.pace.keep(time_ns, 0, if self.shown.is_empty() { &[] } else { contacts });
                self.found.clear();
                self.is_postponed = false;
                return;
            }
        }
        if self.pace.is_due(time_ns, contacts) {
            self.refine_now(time_ns, difference, imager, lowest, contacts);
            let spent_ns = self.estimator.spent_ns();
            // Searches in vain have a pause of their own.
            let is_in_vain = self.pause.is_on(time_ns);
            let busy_ns = if is_in_vain || self.is_unhurried { 0 } else { spent_ns };
            self.pace.keep(time_ns, busy_ns, if self.shown.is_empty() { &[] } else { contacts });
        }
        self.found.clear();
        self.is_postponed = false;
    }

    /// True if presses explain so much of a frame that they are shown.
    fn is_accepted(&self, estimate: &Estimate) -> bool {
        !estimate.presses.is_empty() && estimate.unexplained <= self.most_unexplained
    }

    /// As [`SpotStage::refine`], whenever the last fit was.
    fn refine_now(
        &mut self,
        time_ns: u64,
        difference: &[f64],
        imager: &Imager,
        lowest: f64,
        contacts: &mut Vec<Contact>,
    ) {
        self.hints.clear();
        self.hints.extend(contacts.iter().map(|contact| Press {
            position_m: contact.centroid_m,
            radius_m: self.typical_radius_m,
            load: contact.peak_value,
            ..Press::default()
        }));
        self.is_outstanding = is_outstanding(contacts, lowest);
        if contacts.is_empty() {
            self.pause = Pause::default();
        }
        let of_frame = match self.is_joint {
            true => self.in_vain.pause_of(time_ns, &self.scaled).copied().unwrap_or_default(),
            false => Pause::default(),
        };
        if !self.is_unhurried && (self.pause.is_on(time_ns) || of_frame.is_on(time_ns)) {
            self.shown.clear();
            doubt(contacts, lowest);
            return;
        }
        if !self.is_joint {
            let explained = self.explain(difference);
            return self.show(time_ns, explained, imager, lowest, contacts);
        }
        if !self.is_unhurried {
            self.estimator.allow(AT_ONCE);
        }
        let memory = self.estimator.memory().clone();
        let explained = match self.search.is_under_way() {
            true => Explained::Later(self.estimator.follow(difference)),
            false if self.is_postponed => Explained::Later(None),
            false => self.explain(difference),
        };
        let Explained::Later(so_far) = explained else {
            return self.show(time_ns, explained, imager, lowest, contacts);
        };
        let has_jumped = so_far.is_none();
        let so_far = so_far.filter(|estimate| self.is_accepted(estimate));
        let is_lost = has_jumped || so_far.is_none() && self.estimator.is_out_of_work();
        if !self.search.is_under_way() {
            self.search(time_ns, difference, memory.clone());
        }
        if is_lost {
            self.estimator.set_memory(memory);
        }
        match so_far {
            Some(estimate) => {
                self.learn_positions(&estimate.presses);
                self.show(time_ns, Explained::By(estimate, false), imager, lowest, contacts);
            }
            None if is_lost && !self.shown.is_empty() => self.pace.repeat(contacts),
            None => {
                self.shown.clear();
                doubt(contacts, lowest);
            }
        }
    }

    /// Replaces the contacts of an image by the presses found.
    fn show(&mut self, time_ns: u64, explained: Explained, imager: &Imager, lowest: f64, contacts: &mut Vec<Contact>) {
        self.shown.clear();
        self.peaks.begin(time_ns);
        let Explained::By(estimate, has_gone) = explained else { return };
        if has_gone {
            contacts.clear();
        }
        if estimate.unexplained > self.most_unexplained {
            if self.is_joint {
                self.pause.begin(time_ns);
                self.in_vain.begin(time_ns, &self.scaled);
                self.estimator.forget_presses();
                doubt(contacts, lowest);
                // No later frame continues this search.
                contacts.retain(|contact| !self.is_unhurried || contact.strength != ContactStrength::Weak);
            }
            return;
        }
        if !self.is_joint && estimate.presses.is_empty() && !estimate.is_at_rest && !has_gone {
            // If it stands out, it is too hard a press for the model. Its place in the image is rough.
            contacts.truncate(usize::from(self.is_outstanding));
            let variance_m2 = self.typical_radius_m.powi(2);
            contacts.iter_mut().for_each(|contact| (0..2).for_each(|k| contact.covariance_m2[k][k] += variance_m2));
            return;
        }
        self.pause = Pause::default();
        self.in_vain.forget(&self.scaled);
        self.of_image.clear();
        self.of_image.append(contacts);
        // In a tank, weak presses may be side lobes of a strong one.
        let strongest = estimate.presses.first().map_or(0.0, Press::strength);
        let built = |press: &Press| {
            self.built.as_ref().map_or_else(BuiltVariance::default, |built| built.variance(press.position_m))
        };
        let built: Vec<BuiltVariance> = estimate.presses.iter().map(built).collect();
        let footprints = self.estimator.fit_mut().footprints(&estimate.presses, &built);
        let gain = self.estimator.fit_mut().gain();
        for (k, (press, footprint)) in estimate.presses.iter().zip(footprints).enumerate() {
            if self.is_tank && press.strength() / strongest < LOBE {
                continue;
            }
            self.estimator.fit_mut().channels_of(std::slice::from_ref(press), &mut self.volts);
            let value = self.image_value(imager, press.position_m) / gain;
            if value == 0.0 || !value.is_finite() {
                continue;
            }
            let remains = if self.both_signs { Remains::Press } else { self.peaks.judge(press, value.abs()) };
            if remains != Remains::Press {
                self.sets.extend((remains == Remains::Set).then_some(*press));
                continue;
            }
            let away = |contact: &&Contact| distance(contact.centroid_m, press.position_m);
            let largest = self.estimator.fit_mut().largest_change(press);
            let nearest = self.of_image.iter().min_by(|a, b| away(a).total_cmp(&away(b))).copied();
            // A spot of the sheet is not the contact that caused it.
            let of_image = nearest.filter(|_| !self.is_joint);
            let area_m2 = of_image.map_or(std::f64::consts::PI * footprint.radius_m.powi(2), |contact| contact.area_m2);
            let by_contact = footprint.force_n.map(|[force_n, sigma_n]| ForceReading::FromLaw { force_n, sigma_n });
            let unchanged = Press { load: press.load / gain, ..*press };
            let by_law = || self.law.and_then(|law| law.read(&unchanged, largest, self.polarity, &built[k]));
            let c = &press.covariance;
            let is_far = |contact: &Contact| distance(contact.centroid_m, press.position_m) > self.far_m;
            if !self.is_joint
                && estimate.unexplained > self.explained
                && let Some(contact) = nearest.filter(is_far)
            {
                // Two presses may stand for one contact.
                if contacts.iter().all(|other| other.centroid_m != contact.centroid_m) {
                    contacts.push(contact);
                }
                continue;
            }
            contacts.push(Contact {
                covariance_m2: [0, 1].map(|row| [0, 1].map(|column| estimate.place_scale * c[row][column])),
                significance: estimate.evidence[k],
                radius_m: Some(footprint.radius_m),
                force: by_contact.or_else(by_law),
                model_variance_m2: if self.are_smooth { shape_variance_m2(press, estimate.unexplained) } else { 0.0 },
                is_single: true,
                was_found: self.found.iter().any(|found| press.distance_m(found) < press.radius_m),
                ..Contact::even(press.position_m, value, area_m2)
            });
            self.shown.push(*press);
        }
        contacts.sort_unstable_by(|a, b| b.amplitude.total_cmp(&a.amplitude));
    }

    /// Peak of the image of one press alone, whose response is in `volts`.
    fn image_value(&mut self, imager: &Imager, position_m: Point) -> f64 {
        imager.fill_in_left_out(&mut self.volts);
        let reach = (self.typical_radius_m / self.grid.pixel_m).ceil().max(1.0) as usize;
        let Some(middle) = self.grid.pixel_at(position_m) else { return 0.0 };
        let (row, column) = (middle / self.grid.columns, middle % self.grid.columns);
        let near = |at: usize, count: usize| at.saturating_sub(reach)..(at + reach + 1).min(count);
        let (rows, columns) = (near(row, self.grid.rows), near(column, self.grid.columns));
        let pixels = |row: usize| row * self.grid.columns + columns.start..row * self.grid.columns + columns.end;
        let unknowns = |row: usize| self.unknowns[pixels(row)].iter().flatten().map(|unknown| *unknown as usize);
        // Unknowns are numbered row by row.
        let Some(first) = rows.clone().flat_map(unknowns).next() else { return 0.0 };
        let last = rows.clone().rev().find_map(|row| unknowns(row).next_back()).unwrap_or(first);
        let image = imager.part(first..last + 1, &self.volts, &mut self.part);
        let values = rows.flat_map(unknowns).map(|unknown| f64::from(image[unknown - first]));
        values.fold(0.0, |most: f64, value| if value.abs() > most.abs() { value } else { most })
    }
}
