//! `dermis new`: starts a user's own skin with a commented skin file and its drawing. On a terminal it asks for
//! whatever the options don't give. It never overwrites a file.

use std::fs::OpenOptions;
use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};

use anyhow::Context;
use dermis_device::SourceSelector;
use dermis_device::instruments::csv::read_numbers;
use dermis_skin::{FileError, Skin};
use dermis_tomo::mesh::{Point, distance};

use crate::draw::{self, SkinDrawing};
use crate::exit::{Outcome, UsageError};

const EXAMPLE: &str = "\
Examples:
  dermis new first-pad --outline square:100 --electrodes 16 --layer gel \\
      --instrument none
  dermis new forearm --outline rectangle:180x90 --electrodes 20 --layer foam \\
      --instrument serial:/dev/ttyACM0#lines

Without options it asks. An outline is disc:DIAMETER, square:SIDE, rectangle:WIDTHxHEIGHT (millimetres) or \
polygon:FILE.csv with columns x_mm, y_mm (or x_m, y_m). Layers: gel (salted gelatin, hydrogel), foam (carbon-filled, \
conducts better when pressed), sandwich (a sheet under a metal layer that touches it where pressed), patches (a sheet \
under separate patches), liquid (in a tray under a membrane). NAME.toml explains every line; NAME.svg shows outline, \
electrodes and their numbers. Files are not replaced.";

/// Layers available for a new skin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum LayerName {
    /// Salted gelatin, hydrogel: thins where pressed.
    Gel,
    /// Carbon-filled foam or fabric: conducts better where pressed.
    Foam,
    /// A sheet under a metal layer that touches it where pressed.
    Sandwich,
    /// A sheet under separate patches of metal.
    Patches,
    /// A liquid in a tray under a membrane.
    Liquid,
}

/// Arguments of `dermis new`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    /// Name of the skin, and of its files: letters, digits, - and _.
    name: String,
    /// Its outline: disc:DIAMETER, square:SIDE, rectangle:WIDTHxHEIGHT (mm) or polygon:FILE.csv.
    #[arg(long, value_name = "OUTLINE")]
    outline: Option<String>,
    /// Number of electrodes, evenly spaced around the rim.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(4..=128))]
    electrodes: Option<u32>,
    /// Material of the skin.
    #[arg(long, value_enum)]
    layer: Option<LayerName>,
    /// Instrument that reads it, as for `dermis run --source`; none if there is no instrument yet.
    #[arg(long, value_name = "SOURCE|none")]
    instrument: Option<String>,
    /// Folder for both files; made if it does not exist.
    #[arg(long, value_name = "FOLDER", default_value = ".")]
    out: PathBuf,
}

impl Arguments {
    /// Asks, checks, writes the files and prints the next steps.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_".contains(c);
        if self.name.is_empty()
            || self.name.len() > 100
            || self.name.starts_with('-')
            || !self.name.chars().all(is_plain)
        {
            let text = format!("name {:?}: expected 1 to 100 letters, digits, - and _", self.name);
            return Err(UsageError(text).into());
        }
        // For the current folder show bare file names, as people write them.
        let folder = self.out.strip_prefix(".").unwrap_or(&self.out);
        let [file, drawing] = ["toml", "svg"].map(|ending| folder.join(format!("{}.{ending}", self.name)));
        for path in [&file, &drawing] {
            if path.exists() {
                let text = format!("{}: already exists; expected a new name, or --out FOLDER", path.display());
                return Err(UsageError(text).into());
            }
        }
        let outline = match &self.outline {
            Some(text) => Outline::parse(text)?,
            None => ask(
                out,
                "outline (disc:MM, square:MM, rectangle:MMxMM, polygon:FILE.csv)",
                "square:100",
                Outline::parse,
            )?,
        };
        let electrodes = match self.electrodes {
            Some(count) => count,
            None => ask(out, "electrodes, evenly spaced around the rim (4 to 128)", "16", electrode_count)?,
        };
        let layer = match self.layer {
            Some(layer) => layer,
            None => ask(out, "layer (gel, foam, sandwich, patches, liquid)", "gel", layer_name)?,
        };
        let instrument = match &self.instrument {
            Some(text) => instrument(text)?,
            None => ask(out, "instrument (none, serial:PORT, serial:PORT#lines, tcp:HOST:PORT)", "none", instrument)?,
        };
        let text = skin_file(&self.name, &outline, electrodes, layer, instrument.as_deref());
        // Write nothing unless the skin can be meshed and drawn.
        let skin = Skin::parse(&text, &file.display().to_string())?;
        let body = skin.body()?;
        let picture = SkinDrawing { body: &body.mesh, title: &skin.title, width_px: 1000, mesh: false }.picture();
        std::fs::create_dir_all(&self.out).with_context(|| format!("creating {}", self.out.display()))?;
        write_new(&file, text.as_bytes())?;
        if let Err(error) = write_new(&drawing, draw::svg(&picture).as_bytes()) {
            // A lone file would only get in the way of the next attempt.
            let _ = std::fs::remove_file(&file);
            return Err(error.into());
        }
        next_steps(out, &skin, &file, &drawing, instrument.as_deref())?;
        Ok(Outcome::Done)
    }
}

/// Writes a file that must not exist yet.
fn write_new(path: &Path, content: &[u8]) -> Result<(), dermis_live::Error> {
    let failed = |source| dermis_live::Error::Io(FileError { file: path.to_path_buf(), source });
    let mut file = OpenOptions::new().write(true).create_new(true).open(path).map_err(failed)?;
    file.write_all(content).and_then(|()| file.sync_all()).map_err(failed)
}

/// Asks until the answer is valid. Answers from a pipe are taken line by line, with the default for an empty line and
/// after the last one.
fn ask<T>(
    out: &mut dyn Write,
    question: &str,
    usual: &str,
    parse: impl Fn(&str) -> Result<T, UsageError>,
) -> anyhow::Result<T> {
    let is_terminal = io::stdin().is_terminal();
    loop {
        let mut line = String::new();
        if is_terminal {
            write!(out, "{question} [{usual}]: ")?;
            out.flush()?;
        }
        if io::stdin().read_line(&mut line)? == 0 {
            // A pipe has no more answers.
            if !is_terminal {
                return Ok(parse(usual)?);
            }
            return Err(UsageError("no answer; expected answers or options, see dermis new --help".into()).into());
        }
        let answer = if line.trim().is_empty() { usual } else { line.trim() };
        match parse(answer) {
            Ok(value) => return Ok(value),
            Err(error) if is_terminal => writeln!(out, "{error}")?,
            Err(error) => return Err(error.into()),
        }
    }
}

/// Number of patches that a new skin has at most: the twin's presses act on several cells of each.
const MOST_PATCHES: f64 = 800.0;

/// An outline, millimetres.
#[derive(Clone, Debug, PartialEq)]
enum Outline {
    Disc(f64),
    Rectangle(f64, f64),
    Polygon(Vec<[f64; 2]>),
}

impl Outline {
    fn parse(text: &str) -> Result<Self, UsageError> {
        let expected = "disc:DIAMETER, square:SIDE or rectangle:WIDTHxHEIGHT with 1 to 10000 mm, or polygon:FILE.csv";
        let refused = || UsageError(format!("outline {text:?}: expected {expected}"));
        let length =
            |text: &str| text.trim().parse().ok().filter(|mm: &f64| (1.0..=1e4).contains(mm)).ok_or_else(refused);
        let (kind, size) = text.split_once(':').ok_or_else(refused)?;
        Ok(match kind.trim() {
            "disc" => Self::Disc(length(size)?),
            "square" => Self::Rectangle(length(size)?, length(size)?),
            "rectangle" => {
                let (width, height) = size.split_once('x').ok_or_else(refused)?;
                Self::Rectangle(length(width)?, length(height)?)
            }
            "polygon" => {
                let unreadable = |error: dermis_device::DeviceError| UsageError(format!("outline: {error}"));
                let table = read_numbers(Path::new(size)).map_err(unreadable)?.in_millimetres();
                let corners: Vec<Point> = (0..table.rows()).filter_map(|row| table.row(row)?.try_into().ok()).collect();
                if corners.len() != table.rows() || corners.len() < 3 {
                    let text = format!("outline: {size}: expected at least 3 rows of x_mm, y_mm");
                    return Err(UsageError(text));
                }
                Self::Polygon(corners)
            }
            _ => return Err(refused()),
        })
    }

    /// The shape in skin-file syntax.
    fn shape(&self) -> String {
        match self {
            Self::Disc(mm) => format!("{{ disc = {{ diameter_mm = {mm:?} }} }}"),
            Self::Rectangle(width, height) if width == height => format!("{{ square = {{ side_mm = {width:?} }} }}"),
            Self::Rectangle(width, height) => {
                format!("{{ rectangle = {{ width_mm = {width:?}, height_mm = {height:?} }} }}")
            }
            Self::Polygon(corners) => format!("{{ polygon = {{ outer_mm = {corners:?} }} }}"),
        }
    }

    fn in_words(&self) -> String {
        match self {
            Self::Disc(mm) => format!("disc of {mm} mm"),
            Self::Rectangle(width, height) => format!("{width} x {height} mm"),
            Self::Polygon(corners) => format!("polygon of {} corners", corners.len()),
        }
    }

    fn area_mm2(&self) -> f64 {
        match self {
            Self::Disc(mm) => 0.25 * std::f64::consts::PI * mm * mm,
            Self::Rectangle(width, height) => width * height,
            Self::Polygon(corners) => {
                let next = corners.iter().cycle().skip(1);
                0.5 * corners.iter().zip(next).map(|(a, b)| a[0] * b[1] - b[0] * a[1]).sum::<f64>().abs()
            }
        }
    }

    fn perimeter_mm(&self) -> f64 {
        match self {
            Self::Disc(mm) => std::f64::consts::PI * mm,
            Self::Rectangle(width, height) => 2.0 * (width + height),
            Self::Polygon(corners) => {
                let next = corners.iter().cycle().skip(1);
                corners.iter().zip(next).map(|(a, b)| distance(*a, *b)).sum()
            }
        }
    }
}

fn electrode_count(text: &str) -> Result<u32, UsageError> {
    let count = text.parse().ok().filter(|count| (4..=128).contains(count));
    count.ok_or_else(|| UsageError(format!("electrodes {text:?}: expected a number from 4 to 128")))
}

fn layer_name(text: &str) -> Result<LayerName, UsageError> {
    let expected = || format!("layer {text:?}: expected gel, foam, sandwich, patches or liquid");
    clap::ValueEnum::from_str(text, true).map_err(|_| UsageError(expected()))
}

/// The source of an instrument, if there is one.
fn instrument(text: &str) -> Result<Option<String>, UsageError> {
    let refused = |why: String| UsageError(format!("instrument {text:?}: {why}"));
    if text == "none" {
        return Ok(None);
    }
    match text.parse() {
        Ok(SourceSelector::Tcp { .. } | SourceSelector::Serial { .. }) => Ok(Some(text.to_owned())),
        Ok(_) => Err(refused("expected none, serial:PORT or tcp:HOST:PORT".into())),
        Err(error) => Err(refused(error.to_string())),
    }
}

/// Side of a patch with its gap, millimetres: 10, or more on skins that would have more than [`MOST_PATCHES`].
fn patch_pitch_mm(outline: &Outline) -> f64 {
    (outline.area_mm2() / MOST_PATCHES).sqrt().ceil().max(10.0)
}

/// The line for patches on a skin with this outline.
fn patches_line(outline: &Outline) -> String {
    let pitch_mm = patch_pitch_mm(outline);
    let gap_mm = 0.1 * pitch_mm;
    format!(
        "{{ kind = \"patches\", thickness_mm = 1.0, conductivity_s_per_m = 5.0, pitch_mm = {pitch_mm:?}, \
         gap_mm = {gap_mm:.1} }}"
    )
}

/// The description of the layer, its line, and the imaging settings it needs. `patches` is the line for patches.
fn layer_lines(layer: LayerName, patches: &str) -> [&str; 3] {
    match layer {
        LayerName::Gel => [
            "# Salted gelatin or hydrogel. Measure a bar of it: conductivity = length / (resistance x width x thickness).\n\
             # Pressing thins it, by the pressure over the modulus.",
            "{ kind = \"sheet\", thickness_mm = 5.0, conductivity_s_per_m = 0.2, gauge_factor = 1.0, modulus_kpa = 60.0 }",
            "",
        ],
        LayerName::Foam => [
            "# Carbon-filled foam or fabric. Measure a bar of it: conductivity = length / (resistance x width x thickness).\n\
             # Pressing raises its conductivity by this percentage per kilopascal.",
            "{ kind = \"sheet\", thickness_mm = 5.0, conductivity_s_per_m = 0.5, gauge_factor = 0.0, \
             pressure_percent_per_kpa = 1.0 }",
            "",
        ],
        LayerName::Sandwich => [
            "# A conducting sheet under a gap and a metal layer that touches it where pressed. Measure a bar of the sheet.",
            "{ kind = \"sandwich\", thickness_mm = 1.0, conductivity_s_per_m = 5.0 }",
            "",
        ],
        LayerName::Patches => {
            ["# A conducting sheet under a gap and separate patches of metal that touch it where pressed.", patches, ""]
        }
        LayerName::Liquid => [
            "# Salt water in a tray under a stretched membrane; pressing makes it shallower. 0.1 S/m is 0.5 g of salt per litre.",
            "{ kind = \"liquid\", depth_mm = 10.0, conductivity_s_per_m = 0.1 }",
            "# Depth and salt differ from the file's: each channel is scaled by its own baseline.\ngain = \"channel\"\n",
        ],
    }
}

fn skin_file(name: &str, outline: &Outline, count: u32, layer: LayerName, instrument: Option<&str>) -> String {
    let patches = patches_line(outline);
    let [about_layer, layer_line, imaging] = layer_lines(layer, &patches);
    let words = format!("{layer:?}").to_lowercase();
    let title = format!("{name}: {words}, {}, {count} electrodes", outline.in_words());
    let pitch_mm = outline.perimeter_mm() / f64::from(count);
    let width_mm = (10.0 * (0.4 * pitch_mm).min(10.0)).round() / 10.0;
    let width_mm = width_mm.max(0.1);
    let shape = outline.shape();
    let instrument = instrument.unwrap_or("none yet");
    format!(
        "# {title}.\n\
         # The book's chapter on the skin file and `dermis skins schema` explain these and all other keys.\n\
         name = {name:?}\n\
         title = {title:?}\n\
         modality = \"eit\"\n\n\
         [frontend]\n\
         # Seen from the side that is touched: x to the right, y up, origin at the centre.\n\
         shape = {shape}\n\
         {about_layer}\n\
         layer = {layer_line}\n\
         # Evenly around the rim, counter-clockwise; the drawing shows the numbers. start_deg = ... is the angle of number 1,\n\
         # clockwise = true reverses the direction.\n\
         electrodes = {{ rim = {{ count = {count}, width_mm = {width_mm:?} }} }}\n\
         # Assumed. Four-electrode readings hardly depend on it.\n\
         contact_impedance_ohm_m2 = 1e-4\n\n\
         [backend]\n\
         instrument = {instrument:?}\n\
         # Amplitude of the current.\n\
         current_ma = 1.0\n\
         # Current and voltages between neighbours, beginning with the first pair of electrodes. `dermis order` finds these\n\
         # lines from a file of readings.\n\
         drive = \"adjacent\"\n\
         measure = \"adjacent\"\n\
         # \"rotating\": the readings of each drive begin at its own pair.\n\
         order = \"absolute\"\n\
         # \"keep\": the readings include pairs at driven electrodes.\n\
         driven = \"drop\"\n\
         # \"magnitude\": the instrument gives no sign.\n\
         reads = \"signed\"\n\
         frames_per_s = 25.0\n\n\
         [imaging]\n\
         # Pixels along the longer side.\n\
         grid = 48\n\
         # Larger is smoother; the page has a slider.\n\
         hyperparameter = {{ relative = 0.03 }}\n\
         {imaging}"
    )
}

fn next_steps(
    out: &mut dyn Write,
    skin: &Skin,
    file: &Path,
    drawing: &Path,
    instrument: Option<&str>,
) -> anyhow::Result<()> {
    let (channels, file) = (skin.protocol()?.channel_count(), file.display());
    writeln!(
        out,
        "{file}: {} electrodes, {channels} channels; the drawing is {}",
        skin.electrode_shapes().len(),
        drawing.display()
    )?;
    writeln!(out, "next:")?;
    writeln!(out, "  dermis run {file}                    press its twin in the browser")?;
    writeln!(out, "  dermis design {file}                 predict what it will be able to do")?;
    match instrument {
        Some(source) => {
            writeln!(out, "  dermis doctor {file} --source {source}    check the instrument and its channel order")?;
            writeln!(out, "  dermis run {file} --source {source}")?;
        }
        None => {
            writeln!(out, "  dermis order {file} --baseline rest.csv    find the order of your instrument's readings")?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outlines_are_read_and_written() {
        for (text, shape) in [
            ("disc:80", "{ disc = { diameter_mm = 80.0 } }"),
            ("square:100", "{ square = { side_mm = 100.0 } }"),
            ("rectangle:150x60.5", "{ rectangle = { width_mm = 150.0, height_mm = 60.5 } }"),
        ] {
            assert_eq!(Outline::parse(text).unwrap().shape(), shape);
        }
        for text in ["", "disc", "disc:0", "disc:nan", "square:-1", "rectangle:100", "hexagon:5", "polygon:none.csv"] {
            assert!(Outline::parse(text).is_err(), "{text}");
        }
    }

    #[test]
    fn every_layer_makes_a_skin() {
        for layer in [LayerName::Gel, LayerName::Foam, LayerName::Sandwich, LayerName::Patches, LayerName::Liquid] {
            for outline in ["disc:80", "rectangle:150x60"] {
                let text = skin_file("mine", &Outline::parse(outline).unwrap(), 16, layer, None);
                let skin = Skin::parse(&text, "mine.toml").unwrap_or_else(|error| panic!("{layer:?}: {error}\n{text}"));
                assert_eq!(skin.protocol().unwrap().channel_count(), 208);
            }
        }
    }
}
