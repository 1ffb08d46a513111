//! `dermis body`: checks and draws the skins on a robot before anything moves.

use std::io::Write;
use std::path::{Path, PathBuf};

use dermis::body::check_patch_files;
use dermis_body::{Assigned, Body, DEMO_FILES, JointValues, Problem};
use dermis_device::write_atomic;
use dermis_skin::FileError;

use super::skins::encoder;
use crate::draw::BodyDrawing;
use crate::exit::{Outcome, UsageError};

const EXAMPLE: &str = "\
Examples:
  dermis body check arm/arm.toml
  dermis body draw arm/arm.toml --out arm.svg --joint elbow=0.7
  dermis run arm/arm.toml --headless --frames 50 --speed 0

`dermis body demo FOLDER` writes such an arm.";

const CHECK_EXAMPLE: &str = "\
Example:
  dermis body check arm/arm.toml

Every problem is listed with its file and line. Exit code 1: problems were found.";

const DRAW_EXAMPLE: &str = "\
Example:
  dermis body draw arm/arm.toml --out arm.png --joint shoulder_yaw=0.5 \\
      --joint elbow=1.2

Joints that are not named take the value of joints.at in the body file, or else 0 or the limit nearest to it. Boxes, \
cylinders and spheres are drawn; meshes are not.";

const DEMO_EXAMPLE: &str = "\
Example:
  dermis body demo my-arm
  dermis run my-arm/arm.toml --headless --frames 50 --speed 0";

/// Arguments of `dermis body`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(clap::Subcommand)]
enum Action {
    /// Read a body file with its robot, meshes and skins, and list any faults.
    #[command(after_help = CHECK_EXAMPLE)]
    Check {
        /// The body file.
        #[arg(value_name = "FILE.toml")]
        file: PathBuf,
    },
    /// Draw the robot and the skins on it from the front, the side and above.
    #[command(after_help = DRAW_EXAMPLE)]
    Draw {
        /// The body file.
        #[arg(value_name = "FILE.toml")]
        file: PathBuf,
        /// Output file: SVG, PNG or PDF, by its ending.
        #[arg(long, value_name = "FILE.svg|FILE.png|FILE.pdf")]
        out: PathBuf,
        /// Value of a joint: radians, or metres if it slides.
        #[arg(long, value_name = "NAME=VALUE", value_parser = joint_value)]
        joint: Vec<(String, f64)>,
        /// Width of the picture.
        #[arg(
            long,
            value_name = "PIXELS",
            default_value_t = 1500,
            value_parser = clap::value_parser!(u32).range(300..=8000)
        )]
        width_px: u32,
    },
    /// Write a demonstration: an arm with four skins, each played by its twin.
    #[command(after_help = DEMO_EXAMPLE)]
    Demo {
        /// Output folder, created if needed.
        #[arg(value_name = "FOLDER")]
        folder: PathBuf,
    },
}

fn joint_value(text: &str) -> Result<(String, f64), String> {
    let expected = "expected NAME=VALUE, as in elbow=0.7";
    let (name, value) = text.split_once('=').ok_or(expected)?;
    let value: f64 = value.parse().map_err(|_| expected)?;
    if value.is_finite() { Ok((name.to_owned(), value)) } else { Err(expected.to_owned()) }
}

impl Arguments {
    /// Runs the selected action.
    pub fn run(&self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        match &self.action {
            Action::Check { file } => check(file, out),
            Action::Draw { file, out: to, joint, width_px } => draw(file, to, joint, *width_px, out),
            Action::Demo { folder } => demo(folder, out),
        }
    }
}

fn check(file: &Path, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let (body, problems) = Body::examine(file)?;
    let kinematics = &body.kinematics;
    let robot = match &body.urdf {
        Some((file, _)) => file.display().to_string(),
        None => "no urdf".to_owned(),
    };
    let moving: Vec<&str> = kinematics.moving_joints().collect();
    let links = counted(kinematics.link_names().count(), "link", "links");
    let joints = counted(moving.len(), "moving joint", "moving joints");
    writeln!(out, "{}: {robot}, {links}, {joints}", body.name)?;
    let needed: Vec<&str> = body.needed_joints().into_iter().collect();
    if !needed.is_empty() {
        writeln!(out, "patches depend on {}", needed.join(", "))?;
    }
    let joints = posture(&body, &[])?;
    for (number, patch) in body.patches.iter().enumerate() {
        let (skin, link) = (&patch.skin.name, kinematics.link_name(patch.link));
        write!(out, "  {}: {skin} on {link}, from {}", patch.name, patch.source)?;
        if let Some(place) = body.root_from_patch(number, &joints) {
            let [x, y, z] = place.translation_m.map(|m| 1e3 * m + 0.0);
            let [nx, ny, nz] = place.vector([0.0, 0.0, 1.0]).map(|n| (1e3 * n).round() / 1e3 + 0.0);
            write!(out, "; centre at ({x:.1}, {y:.1}, {z:.1}) mm of {}, facing ({nx}, {ny}, {nz})", body.root())?;
        }
        writeln!(out)?;
    }
    let mut texts: Vec<String> = Vec::new();
    for Problem { error, only_drawn } in &problems {
        texts.push(format!("{}: {error}", if *only_drawn { "not drawn" } else { "problem" }));
    }
    for patch in &body.patches {
        if let Err(error) = check_patch_files(&body, patch) {
            texts.push(format!("problem: {}, line {}: patch {}: {error}", file.display(), patch.line, patch.name));
        }
    }
    for text in &texts {
        writeln!(out, "{text}")?;
    }
    let patches = counted(body.patches.len(), "patch", "patches");
    writeln!(out, "{patches}, {}", counted(texts.len(), "problem", "problems"))?;
    Ok(if texts.is_empty() { Outcome::Done } else { Outcome::ProblemsFound })
}

fn counted(count: usize, one: &str, several: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { several })
}

fn draw(
    file: &Path,
    to: &Path,
    joints: &[(String, f64)],
    width_px: u32,
    out: &mut dyn Write,
) -> anyhow::Result<Outcome> {
    let encode = encoder(to)?;
    let body = Body::open(file)?;
    let joints = posture(&body, joints)?;
    let picture = BodyDrawing { body: &body, joints: &joints, width_px }.picture();
    let content = encode(&picture)?;
    write_atomic(to, |file| file.write_all(&content))?;
    writeln!(out, "{} x {} pixels to {}", picture.width_px, picture.height_px, to.display())?;
    Ok(Outcome::Done)
}

/// Joint values: from the command line, else from the body file, else at rest.
fn posture(body: &Body, asked: &[(String, f64)]) -> anyhow::Result<JointValues> {
    let kinematics = &body.kinematics;
    let mut joints = kinematics.at_rest();
    for name in kinematics.moving_joints() {
        if let Some(value) = kinematics.value(&body.first_joints, name) {
            kinematics.assign(&mut joints, name, value)?;
        }
    }
    for (name, value) in asked {
        if kinematics.assign(&mut joints, name, *value)? != Assigned::Taken {
            let known: Vec<&str> = kinematics.moving_joints().collect();
            let text = format!("--joint {name}: expected a joint that moves by itself: {}", known.join(", "));
            return Err(UsageError(text).into());
        }
    }
    Ok(joints)
}

fn demo(folder: &Path, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    if folder.is_file() {
        return Err(UsageError(format!("{}: a file; expected a folder", folder.display())).into());
    }
    std::fs::create_dir_all(folder)
        .map_err(|source| dermis_live::Error::Io(FileError { file: folder.to_path_buf(), source }))?;
    for (name, _) in DEMO_FILES {
        let path = folder.join(name);
        if path.exists() {
            return Err(UsageError(format!("{}: already exists; expected another folder", path.display())).into());
        }
    }
    for (name, text) in DEMO_FILES {
        let path = folder.join(name);
        write_atomic(&path, |file| file.write_all(text.as_bytes()))?;
        writeln!(out, "written to {}", path.display())?;
    }
    Ok(Outcome::Done)
}
