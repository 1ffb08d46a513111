//! Background of the figures in each paper's replays: the skins used, and what was given, fitted and assumed.

/// How a paper's experiments are replayed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Method {
    /// The paper's letter, as in [`super::PAPERS`].
    pub letter: &'static str,
    /// Authors, title and venue.
    pub source: &'static str,
    /// DOI, if there is one.
    pub doi: Option<&'static str>,
    /// Built-in skins whose twins are used.
    pub skins: &'static [&'static str],
    /// Values taken from the paper.
    pub given: &'static str,
    /// Parameters chosen to reproduce one of the paper's figures.
    pub fitted: &'static str,
    /// Values missing from the paper.
    pub assumed: &'static str,
}

/// The methods of every paper.
pub const METHODS: [Method; 4] = [
    Method {
        letter: "E",
        source: "G. Dingley, M. Cox and M. Soleimani: EM-skin: an artificial robotic skin using magnetic inductance \
                 tomography",
        doi: None,
        skins: &["em-8", "em-16-circular", "em-16-square"],
        given: "coils, frequency, frame rate, signal-to-noise ratios, number and width of the elements",
        fitted: "nothing",
        assumed: "stiffness of sponge (400 N/m) and springs (300 N/m), the elements' travel (11 and 12 mm), their \
                  heights and pitch, the coils' pitch and layers, the current",
    },
    Method {
        letter: "H",
        source: "H. Chen, Z. Wang and others: A self-healing electrical impedance tomography sensor for the selective \
                 localization of compression and damage based on a Diels-Alder conductive composite",
        doi: None,
        skins: &["healing-square"],
        given: "sheet, pads, conductivity and healing by the sample bars, indenters, pressures, heat and rest",
        fitted: "the instrument's noise, to the printed signal-to-noise ratios (56.8 dB on average); the scar, to the \
                 bars (2.07 to 2.15 kΩ)",
        assumed: "the law of contact between sheet and copper, the pads' contact impedance, the frame rate, warmth and \
                  activation energy of healing, width of a cut (0.3 mm)",
    },
    Method {
        letter: "I",
        source: "M. Soleimani and M. Friedrich: E-skin using fringing field electrical impedance tomography with an \
                 ionic liquid domain, Sensors 22, 5040 (2022)",
        doi: Some("10.3390/s22135040"),
        skins: &["ionic-disc", "ionic-square"],
        given: "outlines, depth, membrane, bolts and washers, 6 mA at 50 kHz, patterns, 16 frames a second, 59.7 \
        dB, weights",
        fitted: "the membrane's tension (60 N/m) and memory (5 % of the load within 20 s), so that force curves are \
                 near linear, one weight is seen and the loop is small; the noise, to 59.7 dB taken as a ratio of \
                 amplitudes",
        assumed: "the liquid's conductivity (0.5 S/m) and the contact impedance, which scale the voltages; washers as \
                  squares of equal area",
    },
    Method {
        letter: "P",
        source: "A. Sánchez-Delgado and others: Frontend and backend electronics achieving flexibility and scalability \
                 for tomographic tactile sensing, Intelligent Service Robotics 17 (2024)",
        doi: Some("10.1007/s11370-023-00502-5"),
        skins: &["piezo-square", "piezo-disc", "piezo-cylinder"],
        given: "outlines, number of electrodes, layers, indenter, weights and shifts",
        fitted: "the contact's reference pressure (0.888 kPa), on the square's limit of detection alone",
        assumed: "places, size and contact impedance of the electrodes, the sheet's resistance, pitch and gap \
                  pressure of the patches, exponent and saturation of the contact, the noise",
    },
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiments::PAPERS;
    use dermis_skin::BUILTIN_NAMES;

    #[test]
    fn every_paper_has_its_method_and_the_skins_exist() {
        let letters = |list: &[&'static str]| list.to_vec();
        assert_eq!(letters(&METHODS.map(|method| method.letter)), letters(&PAPERS.map(|paper| paper.0)));
        for name in METHODS.iter().flat_map(|method| method.skins) {
            assert!(BUILTIN_NAMES.contains(name), "{name}");
        }
    }
}
