//! `dermis skins`: lists skins, shows a skin file with its defaults filled in, and draws skins.

use std::io::Write;
use std::path::{Path, PathBuf};

use dermis_device::write_atomic;
use dermis_skin::budget::Budget;
use dermis_skin::{BUILTIN_NAMES, Skin, SkinBody};

use crate::draw::{self, Picture, SkinDrawing};
use crate::exit::{Outcome, UsageError};

const EXAMPLE: &str = "\
Examples:
  dermis skins list
  dermis skins show healing-square
  dermis skins draw healing-square --out skin.svg";

const SHOW_EXAMPLE: &str = "\
Example:
  dermis skins show hydrogel-disc

The output is a complete skin file, including defaults: a starting point for your own skin.";

const DRAW_EXAMPLE: &str = "\
Examples:
  dermis skins draw ktc-tank --out tank.png --width-px 800
  dermis skins draw healing-square --out skin.svg --no-mesh";

/// Arguments of `dermis skins`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(clap::Subcommand)]
enum Action {
    /// List the built-in skins.
    #[command(after_help = "Example:\n  dermis skins list --json")]
    List {
        /// Print JSON instead of a table.
        #[arg(long)]
        json: bool,
    },
    /// Show a skin as a skin file, with every default filled in.
    #[command(after_help = SHOW_EXAMPLE)]
    Show {
        /// Name of a built-in skin, or a skin file.
        #[arg(value_name = "NAME|FILE")]
        skin: String,
    },
    /// Print the format of skin files as a JSON Schema, for editors.
    #[command(after_help = "Example:\n  dermis skins schema")]
    Schema,
    /// Draw a skin to scale: mesh, outline, numbered electrodes.
    #[command(after_help = DRAW_EXAMPLE)]
    Draw {
        /// Name of a built-in skin, or a skin file.
        #[arg(value_name = "NAME|FILE")]
        skin: String,
        /// Output file: SVG, PNG or PDF, by its ending.
        #[arg(long, value_name = "FILE.svg|FILE.png|FILE.pdf")]
        out: PathBuf,
        /// Width of the picture.
        #[arg(
            long,
            value_name = "PIXELS",
            default_value_t = 1000,
            value_parser = clap::value_parser!(u32).range(200..=8000)
        )]
        width_px: u32,
        /// Leave out the mesh.
        #[arg(long)]
        no_mesh: bool,
    },
}

impl Arguments {
    /// Runs the selected action.
    pub fn run(&self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        match &self.action {
            Action::List { json } => list(*json, out),
            Action::Show { skin } => show(skin, out),
            Action::Schema => {
                writeln!(out, "{}", serde_json::to_string_pretty(&dermis_skin::json_schema())?)?;
                Ok(Outcome::Done)
            }
            Action::Draw { skin, out: path, width_px, no_mesh } => draw_skin(skin, path, *width_px, !*no_mesh, out),
        }
    }
}

fn list(json: bool, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    if json {
        let skin = |name: &&str| -> anyhow::Result<serde_json::Value> {
            Ok(serde_json::json!({ "name": name, "title": Skin::open(name)?.title }))
        };
        let all: Vec<serde_json::Value> = BUILTIN_NAMES.iter().map(skin).collect::<Result<_, _>>()?;
        super::print_json(&all, out)?;
        return Ok(Outcome::Done);
    }
    let longest = BUILTIN_NAMES.iter().map(|name| name.len()).max().unwrap_or(0);
    for name in BUILTIN_NAMES {
        writeln!(out, "{name:longest$}  {}", Skin::open(name)?.title)?;
    }
    Ok(Outcome::Done)
}

fn show(name: &str, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let skin = Skin::open(name)?;
    // Refuse the same skins as `draw`.
    skin.body()?;
    let protocol = skin.protocol()?;
    meshed(&skin)?;
    let (low, high) = skin.outline().bounds_m();
    let (width_mm, height_mm) = (1e3 * (high[0] - low[0]), 1e3 * (high[1] - low[1]));
    let (count, drives, channels) =
        (protocol.electrode_count(), protocol.stimulations().len(), protocol.channel_count());
    let what = match &skin.frontend.elements {
        Some(elements) => {
            let elements = elements.count();
            format!("{count} coils, {elements} elements, {channels} channels")
        }
        None => {
            let conductance_ms = 1e3 * skin.sheet_conductance_s();
            format!(
                "{count} electrodes, {drives} drives, {channels} channels, sheet conductance {conductance_ms:.4} mS"
            )
        }
    };
    writeln!(out, "# {width_mm:.1} x {height_mm:.1} mm, {what}")?;
    for (number, moved_mm) in (1..).zip(skin.frontend.electrodes.moved_mm(&skin.outline())) {
        if moved_mm > 0.0 {
            writeln!(out, "# electrode {number}: moved to the rim, {moved_mm:.2} mm from its place")?;
        }
    }
    write!(out, "{}", skin.to_toml())?;
    Ok(Outcome::Done)
}

/// A skin's mesh, unless it exceeds the size limit. `show` and `draw` thus refuse the same skins.
fn meshed(skin: &Skin) -> anyhow::Result<SkinBody> {
    Budget::of_imaging(skin).check(skin, "its image")?;
    Ok(skin.body()?)
}

fn draw_skin(name: &str, path: &Path, width_px: u32, mesh: bool, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let encode = encoder(path)?;
    let skin = Skin::open(name)?;
    let body = meshed(&skin)?;
    let title = if skin.title.is_empty() { &skin.name } else { &skin.title };
    let picture = SkinDrawing { body: &body.mesh, title, width_px, mesh }.picture();
    let content = encode(&picture)?;
    write_atomic(path, |file| file.write_all(&content))?;
    writeln!(out, "{} x {} pixels to {}", picture.width_px, picture.height_px, path.display())?;
    Ok(Outcome::Done)
}

/// The drawing of a skin as SVG.
///
/// # Errors
/// The skin cannot be meshed.
pub fn skin_svg(skin: &Skin) -> anyhow::Result<String> {
    let body = meshed(skin)?;
    let title = if skin.title.is_empty() { &skin.name } else { &skin.title };
    Ok(draw::svg(&SkinDrawing { body: &body.mesh, title, width_px: 640, mesh: false }.picture()))
}

pub(super) type Encoder = fn(&Picture) -> anyhow::Result<Vec<u8>>;

/// The picture format for a file's ending.
///
/// # Errors
/// The ending is unknown.
pub(super) fn encoder(path: &Path) -> Result<Encoder, UsageError> {
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    match extension.as_deref() {
        Some("svg") => Ok(|picture| Ok(draw::svg(picture).into_bytes())),
        Some("png") => Ok(|picture| draw::png(picture, 1)),
        Some("pdf") => Ok(|picture| Ok(draw::pdf(picture))),
        _ => Err(UsageError(format!("--out {}: expected a name that ends in .svg, .png or .pdf", path.display()))),
    }
}
