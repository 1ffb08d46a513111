//! Time: one element held, and elements pressed in a rhythm.

use dermis_touch::rhythm::{Spectrum, SpectrumAnalyser};

use super::array::{Bench, EIGHT, row, solve_name};
use crate::Error;
use crate::report::{Curve, Experiment, Figure, Kind, Look, Report};
use crate::twin_bench::distance_mm;
use dermis_skin::Solve;

/// Frames of a rhythm: 12.8 s, so spectral lines are 0.078 Hz apart.
const FRAMES: usize = 128;

pub(super) const STABILITY: Experiment =
    Experiment { id: "E6", title: "one element held for 100 frames", run: stability };

/// E6: one element pressed for 100 frames.
fn stability() -> Result<Report, Error> {
    let (mut rows, mut curves) = (Vec::new(), Vec::new());
    for solve in [Solve::Pixels, Solve::LiftOff] {
        let mut bench = EIGHT.bench(solve)?;
        let (element, name) = (6, solve_name(solve));
        let indenters = [bench.press(element, bench.press_n)];
        bench.rig.frames(&indenters, 20)?;
        let (mut values, mut farthest) = (Vec::new(), 0.0_f64);
        for frame in &bench.rig.frames(&indenters, 100)? {
            let image = bench.rig.image(frame)?;
            farthest = farthest.max(distance_mm(bench.rig.peak(&image).0, bench.places[element]));
            values.push(bench.rig.mean_around(&image, bench.places[element]));
        }
        let (mean, deviation) = super::force::mean_and_deviation(&values);
        rows.push(row(format!("{name}: scatter there over its mean"), "", None, deviation / mean, Kind::Predicted));
        let quantity = format!("{name}: largest distance of the peak in 100 frames");
        rows.push(row(quantity, "mm", Some(0.0), farthest, Kind::Algorithm));
        let points = values.iter().enumerate().map(|(k, v)| [k as f64, v / mean]).collect();
        curves.push(Curve { name: name.into(), points, look: Look::Line });
    }
    let title = "E6: element 7 over its mean".into();
    let caption =
        "Image at element 7 of the EM-skin's twin with eight coils over its mean, in 100 single frames while the \
                   element is held down, by the linear image and by the fit of heights."
            .into();
    let (x_label, y_label) = ("frame", "value over the mean");
    let figures = vec![Figure::Curves { name: "stability", title, caption, x_label, y_label, curves }];
    let notes = vec!["A pixel is 3 mm: the peak of an element between pixel centres lies up to 2 mm off.".into()];
    Ok(Report { id: STABILITY.id, title: STABILITY.title, rows, figures, notes })
}

pub(super) const CYCLIC: Experiment = Experiment { id: "E7", title: "cyclic touch at 3 Hz", run: cyclic };

/// E7: one element pressed at 3 Hz, and the spectrum of the frame's mean.
fn cyclic() -> Result<Report, Error> {
    let mut bench = EIGHT.bench(Solve::LiftOff)?;
    let series = rhythms(&mut bench, &[(12, 3.0)])?;
    let rate_hz = 1.0 / bench.rig.frame_s();
    let spectrum = SpectrumAnalyser::new(FRAMES, rate_hz)?.spectrum(&series.frame_mean)?;
    let rows = vec![row("largest peak of the frame's mean", "Hz", Some(3.0), largest_hz(&spectrum), Kind::Predicted)];
    let curves = vec![Curve { name: "frame's mean".into(), points: lines(&spectrum), look: Look::Line }];
    let (time, title) = (points(&series.frame_mean, rate_hz), "E7: one element pressed at 3 Hz".to_string());
    let figures = vec![
        Figure::Curves {
            name: "cyclic-time",
            title: title.clone(),
            caption: "Mean of the whole image of the EM-skin's twin with eight coils over time, one element pressed \
                      at 3 Hz; ten frames a second."
                .into(),
            x_label: "time (s)",
            y_label: "mean of the image (share of travel)",
            curves: vec![Curve { name: "frame's mean".into(), points: time, look: Look::Line }],
        },
        Figure::Curves {
            name: "cyclic",
            title,
            caption: "Amplitude spectrum of the mean of the whole image while one element of the EM-skin's twin with \
                      eight coils is pressed at 3 Hz; 128 frames."
                .into(),
            x_label: "frequency (Hz)",
            y_label: "amplitude (share of travel)",
            curves,
        },
        Figure::Images {
            name: "cyclic-frames",
            title: "E7: successive frames".into(),
            caption: "Six images in succession, 0.1 s apart, while one element of the EM-skin's twin with eight coils \
                      is pressed at 3 Hz."
                .into(),
            columns: bench.rig.columns(),
            panels: series.panels,
        },
    ];
    let notes = vec!["Ten frames a second; lines of the spectrum are 0.078 Hz apart.".into()];
    Ok(Report { id: CYCLIC.id, title: CYCLIC.title, rows, figures, notes })
}

pub(super) const TWO_RHYTHMS: Experiment =
    Experiment { id: "E8", title: "two elements at 0.5 and 2 Hz at once", run: two_rhythms };

/// E8: two elements pressed at once, each with its own rhythm.
fn two_rhythms() -> Result<Report, Error> {
    let mut bench = EIGHT.bench(Solve::LiftOff)?;
    let pressed = [(6, 0.5), (18, 2.0)];
    let series = rhythms(&mut bench, &pressed)?;
    let rate_hz = 1.0 / bench.rig.frame_s();
    let analyser = SpectrumAnalyser::new(FRAMES, rate_hz)?;
    let (mut rows, mut curves) = (Vec::new(), Vec::new());
    for ((element, frequency_hz), values) in pressed.iter().zip(&series.elements) {
        let spectrum = analyser.spectrum(values)?;
        let name = format!("element {}", element + 1);
        rows.push(row(
            format!("{name}: largest peak"),
            "Hz",
            Some(*frequency_hz),
            largest_hz(&spectrum),
            Kind::Predicted,
        ));
        curves.push(Curve { name, points: lines(&spectrum), look: Look::Line });
    }
    let whole = analyser.spectrum(&series.frame_mean)?;
    let mut peaks: Vec<f64> = whole.peaks(2, 0.0).iter().map(|peak| peak.frequency_hz).collect();
    peaks.sort_by(f64::total_cmp);
    for (expected, found) in [0.5, 2.0].iter().zip(peaks) {
        rows.push(row(format!("frame's mean: peak by {expected} Hz"), "Hz", Some(*expected), found, Kind::Predicted));
    }
    curves.push(Curve { name: "frame's mean".into(), points: lines(&whole), look: Look::Line });
    let title = "E8: two elements at 0.5 and 2 Hz".into();
    let caption =
        "Amplitude spectra while two elements of the EM-skin's twin with eight coils are pressed at once, at 0.5 and \
                   2 Hz: of the nine pixels at each, and of the mean of the whole image; 128 frames."
            .into();
    let (x_label, y_label) = ("frequency (Hz)", "amplitude (share of travel)");
    let figures = vec![Figure::Curves { name: "two-rhythms", title, caption, x_label, y_label, curves }];
    let notes =
        vec!["Each element's spectrum is that of its own 3 x 3 pixels: the two are told apart in space.".into()];
    Ok(Report { id: TWO_RHYTHMS.id, title: TWO_RHYTHMS.title, rows, figures, notes })
}

struct Series {
    frame_mean: Vec<f64>,
    /// One series per pressed element.
    elements: Vec<Vec<f64>>,
    panels: Vec<crate::experiments::ImagePanel>,
}

/// Presses each element with a raised cosine, up to the usual force.
fn rhythms(bench: &mut Bench, pressed: &[(usize, f64)]) -> Result<Series, Error> {
    let mut series = Series { frame_mean: Vec::new(), elements: vec![Vec::new(); pressed.len()], panels: Vec::new() };
    for k in 0..FRAMES {
        let time_s = k as f64 * bench.rig.frame_s();
        let force = |hz: f64| bench.press_n * (0.5 - 0.5 * (std::f64::consts::TAU * hz * time_s).cos());
        let indenters: Vec<_> = pressed
            .iter()
            .map(|(element, hz)| (*element, force(*hz)))
            .filter(|(_, force_n)| *force_n > 1e-6)
            .map(|(element, force_n)| bench.press(element, force_n))
            .collect();
        let frame = bench.rig.frames(&indenters, 1)?.swap_remove(0);
        let image = bench.rig.image(&frame)?;
        let finite: Vec<f64> = image.iter().filter(|v| v.is_finite()).map(|v| f64::from(*v)).collect();
        series.frame_mean.push(finite.iter().sum::<f64>() / finite.len() as f64);
        for ((element, _), values) in pressed.iter().zip(&mut series.elements) {
            values.push(bench.rig.mean_around(&image, bench.places[*element]));
        }
        if (20..26).contains(&k) {
            let at: Vec<usize> = pressed.iter().map(|(element, _)| *element).collect();
            series.panels.push(bench.rig.panel(format!("{time_s:.1} s"), &image, &bench.at(&at)));
        }
    }
    Ok(series)
}

fn largest_hz(spectrum: &Spectrum) -> f64 {
    spectrum.peaks(1, 0.0).first().map_or(f64::NAN, |peak| peak.frequency_hz)
}

fn lines(spectrum: &Spectrum) -> Vec<[f64; 2]> {
    spectrum.amplitudes.iter().enumerate().map(|(k, amplitude)| [spectrum.bin_hz * k as f64, *amplitude]).collect()
}

fn points(values: &[f64], rate_hz: f64) -> Vec<[f64; 2]> {
    values.iter().enumerate().map(|(k, v)| [k as f64 / rate_hz, *v]).collect()
}
