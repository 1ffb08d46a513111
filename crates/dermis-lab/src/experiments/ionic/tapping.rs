//! I10: a finger taps the centre of the skin.

use dermis_skin::Modality;
use dermis_touch::rhythm::SpectrumAnalyser;

use super::bench::{DIAMETER_MM, SKIN, row};
use crate::Error;
use crate::report::{Curve, Experiment, Figure, ImagePanel, Kind, Look, Report};
use crate::twin_bench::{Rig, disc};

pub(super) const TAPPING: Experiment =
    Experiment { id: "I10", title: "tapping, from 1 Hz to the Nyquist limit", run: tapping };

/// I10: the pixel under a tapping finger, and its spectrum.
fn tapping() -> Result<Report, Error> {
    let mut rig = Rig::new(SKIN)?;
    let rate = 1.0 / rig.frame_s();
    let (mut rows, mut spectra, mut course, mut panels) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let mut slices = Vec::new();
    for frequency in [1.0, 2.5, 5.0, 7.5] {
        let (mut series, mut images) = (Vec::new(), Vec::new());
        for k in 0..256 {
            let time = f64::from(k) / rate;
            let press = 0.5 * (1.0 - (std::f64::consts::TAU * frequency * time).cos());
            let indenter = disc([0.0; 2], DIAMETER_MM, 0.3 * press);
            let frame = rig.mean_frame(&[indenter], 1)?;
            let image = rig.image(&frame)?;
            series.push(rig.mean_around(&image, [0.0; 2]));
            images.extend((k < SLICE_FRAMES as i32).then_some(image));
        }
        if frequency == 1.0 {
            let second = &images[16..];
            let panel = |k: &usize| rig.panel(format!("{:.3} s", *k as f64 / rate), &second[*k], &[[0.0; 2]]);
            panels = [0, 2, 4, 6, 8, 10, 12, 14].iter().map(panel).collect();
            slices = through_the_centre(&images, rig.columns());
            course = series.iter().enumerate().take(96).map(|(k, v)| [k as f64 / rate, *v]).collect();
        }
        let spectrum = SpectrumAnalyser::new(series.len(), rate)?.spectrum(&series)?;
        let peak = spectrum.peaks(1, 0.0).first().map_or(f64::NAN, |peak| peak.frequency_hz);
        let line = |(k, amplitude): (usize, &f64)| [spectrum.bin_hz * k as f64, *amplitude];
        let points: Vec<[f64; 2]> = spectrum.amplitudes.iter().enumerate().map(line).collect();
        let paper = (frequency == 1.0).then_some(1.0);
        rows.push(row(format!("tapped at {frequency} Hz: largest peak"), "Hz", paper, peak, Kind::Algorithm));
        spectra.push(Curve { name: format!("{frequency} Hz"), points, look: Look::Line });
        rig.frames(&[], 30)?;
    }
    let figures = vec![
        Figure::Curves {
            name: "course",
            title: "I10: centre of the skin, tapped at 1 Hz".into(),
            caption:
                "Mean of the nine middle pixels over time while a disc of 20 mm taps the centre of the ionic disc's \
                      twin with up to 0.3 N at 1 Hz."
                    .into(),
            x_label: "time (s)",
            y_label: "mean of 9 pixels (relative change)",
            curves: vec![Curve { name: String::new(), points: course, look: Look::Line }],
        },
        Figure::Curves {
            name: "spectra",
            title: "I10: spectra".into(),
            caption:
                "Amplitude spectra of the nine middle pixels while the centre of the ionic disc's twin is tapped at \
                      four frequencies, 256 frames each. The paper taps at 1 Hz."
                    .into(),
            x_label: "frequency (Hz)",
            y_label: "amplitude (relative change)",
            curves: spectra,
        },
        Figure::Images {
            name: "period",
            title: "I10: one period of tapping at 1 Hz".into(),
            caption: "Every second image of one second of tapping the centre of the ionic disc's twin at 1 Hz.".into(),
            columns: rig.columns(),
            panels,
        },
        Figure::Images {
            name: "slices",
            title: "I10: slices over time, 3 s downward".into(),
            caption:
                "Middle row (x) and middle column (y) of the image of the ionic disc's twin, tapped at 1 Hz; each line \
                      of pixels is a frame, 48 frames in all, and time runs downward."
                    .into(),
            columns: rig.columns(),
            panels: slices,
        },
    ];
    let notes = vec![format!("{rate} frames/s: the Nyquist limit is {} Hz.", 0.5 * rate)];
    Ok(Report { id: TAPPING.id, title: TAPPING.title, rows, figures, notes })
}

/// Number of frames in a slice through the images over time.
const SLICE_FRAMES: usize = 48;

/// Slices through the images over time along the middle row and column; each frame is one row.
fn through_the_centre(images: &[Vec<f32>], columns: usize) -> Vec<ImagePanel> {
    let panel = |name: &str, pixel: &dyn Fn(usize) -> usize| ImagePanel {
        name: name.into(),
        values: images.iter().flat_map(|image| (0..columns).map(|k| image[pixel(k)])).collect(),
        marks: Vec::new(),
        bend: None,
        quantity: Modality::Eit.image_quantity(),
        width_mm: None,
    };
    let middle = columns / 2;
    vec![
        panel("x over time", &|k| middle * columns + k),
        panel("y over time", &|k| (columns - 1 - k) * columns + middle),
    ]
}
