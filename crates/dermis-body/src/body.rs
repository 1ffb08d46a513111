//! A body: a robot, and the skins mounted on its links.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use dermis_skin::{Skin, builtin_text};
use dermis_tomo::mesh::Surface;
use toml::Spanned;

use crate::body_file::{BodyText, PatchText, Source};
use crate::error::{Error, listed};
use crate::files;
use crate::joint_source::{self, JointSource};
use crate::kinematics::{JointValues, Kinematics};
use crate::transform::{Transform, Vector};
use crate::urdf::{Geometry, Urdf};

/// Name of the only link of a body without a URDF file.
pub const ONLY_LINK: &str = "body";
/// Maximum number of patches on one body.
pub const MOST_PATCHES: usize = 256;
/// Joint values older than this are stale unless the body file says otherwise, milliseconds: ten periods of a robot
/// that publishes at 50 Hz, the slowest in common use.
const STALE_AFTER_MS: f64 = 200.0;
/// Largest offset of a patch on its link, mm.
const MOST_MM: f64 = 1e5;

/// A robot and the skins on it.
#[derive(Clone, Debug)]
pub struct Body {
    /// Name of the body.
    pub name: String,
    /// The body file.
    pub file: PathBuf,
    /// The robot's URDF file and its content, if there is one.
    pub urdf: Option<(PathBuf, Urdf)>,
    /// The robot's mesh files, or why they cannot be used, by their names in the URDF file.
    pub meshes: BTreeMap<String, Result<PathBuf, String>>,
    /// Links and joints.
    pub kinematics: Kinematics,
    /// Source of joint values named in the body file.
    pub joint_source: Option<JointSource>,
    /// Joint values older than this are stale, seconds.
    pub joints_stale_after_s: f64,
    /// Joint values from `joints.at`, used until others arrive.
    pub first_joints: JointValues,
    /// The skins, in file order.
    pub patches: Vec<Patch>,
}

/// A skin on a link.
#[derive(Clone, Debug)]
pub struct Patch {
    /// Name, unique on the body.
    pub name: String,
    /// Line of the name in the body file, from 1.
    pub line: usize,
    /// The skin, with the patch's own guard if it has one.
    pub skin: Skin,
    /// Source of its frames, as for `dermis run --source`.
    pub source: String,
    /// Number of the link that carries it.
    pub link: usize,
    /// Its pose on the link.
    pub link_from_patch: Transform,
    /// Frames of the untouched skin, `FILE[#FRAMES]`.
    pub baseline: Option<String>,
    /// A calibration made by `dermis calibrate`.
    pub calibration: Option<PathBuf>,
    /// A force calibration.
    pub forces: Option<PathBuf>,
}

/// A problem of a body.
#[derive(Debug)]
pub struct Problem {
    /// The problem, with its file and line.
    pub error: Error,
    /// True if it affects drawings only.
    pub only_drawn: bool,
}

impl Patch {
    /// The shape of the skin in the patch's frame.
    pub fn surface(&self) -> Surface {
        self.skin.surface()
    }
}

impl Body {
    /// Reads a body file, its URDF file and its skins.
    ///
    /// # Errors
    /// The first problem found; meshes that cannot be read are ignored.
    pub fn open(file: &Path) -> Result<Self, Error> {
        let (body, problems) = Self::examine(file)?;
        problems.into_iter().find(|problem| !problem.only_drawn).map_or(Ok(body), |problem| Err(problem.error))
    }

    /// Reads a body file without the patches that cannot be used, and returns all problems.
    ///
    /// # Errors
    /// A file cannot be read or parsed, or the joints don't form a tree; then there is no body.
    pub fn examine(file: &Path) -> Result<(Self, Vec<Problem>), Error> {
        let (source, text) = Source::open(file)?;
        Builder { source, meshes: BTreeMap::new(), problems: Vec::new() }.build(text)
    }

    /// Pose of a patch; `None` if a joint on the way has no value.
    pub fn root_from_patch(&self, patch: usize, joints: &JointValues) -> Option<Transform> {
        let Patch { link, link_from_patch, .. } = &self.patches[patch];
        Some(self.kinematics.root_from_link(*link, joints)? * *link_from_patch)
    }

    /// Names of the joints that patches depend on.
    pub fn needed_joints(&self) -> BTreeSet<&str> {
        let of = |patch: &Patch| self.kinematics.joints_of(patch.link).unwrap_or_default();
        self.patches.iter().flat_map(of).collect()
    }

    /// Name of the frame that results are given in: the root link, which no joint carries.
    pub fn root(&self) -> &str {
        self.kinematics.link_name(self.kinematics.root())
    }
}

/// A body being read.
struct Builder {
    source: Source,
    meshes: BTreeMap<String, Result<PathBuf, String>>,
    problems: Vec<Problem>,
}

impl Builder {
    fn build(mut self, text: BodyText) -> Result<(Body, Vec<Problem>), Error> {
        let urdf = match &text.urdf {
            Some(path) => Some(self.urdf(path, &text)?),
            None => None,
        };
        let kinematics = match &urdf {
            Some((file, urdf)) => Kinematics::new(urdf, file)?,
            None => Kinematics::of_one_link(ONLY_LINK),
        };
        let mut first_joints = kinematics.unknown();
        for (name, value) in &text.joints.at {
            self.take_joint(&kinematics, &mut first_joints, name, value)?;
        }
        let stale_after_ms = match &text.joints.stale_after_ms {
            None => STALE_AFTER_MS,
            Some(value) if *value.get_ref() > 0.0 && *value.get_ref() <= 1e6 => *value.get_ref(),
            Some(value) => {
                let expected = "milliseconds above 0, at most 1e6";
                return Err(self.source.refused(value, "joints.stale_after_ms", value.get_ref(), expected));
            }
        };
        let joint_source = text.joints.source.as_ref().map(|source| self.joint_source(source)).transpose()?;
        let stem = || self.source.file.file_stem().map(|stem| stem.to_string_lossy().into_owned());
        let mut body = Body {
            name: text.name.or_else(stem).unwrap_or_default(),
            file: self.source.file.clone(),
            urdf,
            meshes: std::mem::take(&mut self.meshes),
            kinematics,
            joint_source,
            joints_stale_after_s: 1e-3 * stale_after_ms,
            first_joints,
            patches: Vec::new(),
        };
        if text.patch.is_empty() {
            let message = "no [[patch]]: expected at least one, with name, skin and link".to_owned();
            return Err(Error::BodyFile { file: self.source.file, message });
        }
        if let Some(first) = text.patch.get(MOST_PATCHES) {
            let expected = format!("at most {MOST_PATCHES} patches");
            return Err(self.source.refused(&first.name, "patch", text.patch.len(), expected));
        }
        for (number, patch) in text.patch.iter().enumerate() {
            match self.patch(patch, &body, &text.patch[..number]) {
                Ok(good) => body.patches.push(good),
                Err(error) => self.problems.push(Problem { error, only_drawn: false }),
            }
        }
        Ok((body, self.problems))
    }

    fn urdf(&mut self, path: &Spanned<PathBuf>, text: &BodyText) -> Result<(PathBuf, Urdf), Error> {
        let folder = self.source.folder();
        let file = folder.join(path.get_ref());
        if !file.is_file() {
            let expected = "a URDF file, its path relative to the body file";
            return Err(self.source.refused(path, "urdf", path.get_ref().display(), expected));
        }
        let urdf = Urdf::open(&file)?;
        let packages: Vec<(String, PathBuf)> =
            text.packages.iter().map(|(name, place)| (name.clone(), folder.join(place))).collect();
        let mut seen = BTreeSet::new();
        for shape in urdf.links.iter().flat_map(|link| &link.shapes) {
            let Geometry::Mesh { filename, .. } = &shape.geometry else { continue };
            if !seen.insert(filename) {
                continue;
            }
            let found = files::resolve(filename, &file, &packages);
            let at = found.as_ref().map_or(String::new(), |place| format!("{}: ", place.display()));
            let checked = found.and_then(|place| files::check_mesh(&place).map(|()| place));
            if let Err(reason) = &checked {
                let message = format!("mesh {filename:?}: {at}{reason}");
                let error = Error::Urdf { file: file.clone(), line: shape.line, message };
                self.problems.push(Problem { error, only_drawn: true });
            }
            self.meshes.insert(filename.clone(), checked);
        }
        Ok((file, urdf))
    }

    /// The source of joint values, with a file that exists.
    fn joint_source(&self, text: &Spanned<String>) -> Result<JointSource, Error> {
        let refused = || self.source.refused(text, "joints.source", text.get_ref(), joint_source::EXPECTED);
        let source = text.get_ref().parse::<JointSource>().map_err(|_| refused())?.in_folder(self.source.folder());
        match &source {
            JointSource::File(file) if !file.exists() => Err(refused()),
            _ => Ok(source),
        }
    }

    fn take_joint(
        &self,
        kinematics: &Kinematics,
        joints: &mut JointValues,
        name: &str,
        value: &Spanned<f64>,
    ) -> Result<(), Error> {
        use crate::kinematics::Assigned::Taken;
        let field = format!("joints.at.{name}");
        if !value.get_ref().is_finite() {
            return Err(self.source.refused(value, field, value.get_ref(), "a finite number, radians or metres"));
        }
        if kinematics.assign(joints, name, *value.get_ref())? == Taken {
            return Ok(());
        }
        let known = listed(kinematics.moving_joints());
        Err(self.source.refused(value, field, value.get_ref(), format!("a joint that moves by itself: {known}")))
    }

    fn patch(&self, text: &PatchText, body: &Body, before: &[PatchText]) -> Result<Patch, Error> {
        let name = text.name.get_ref();
        let is_plain = |c: char| c.is_alphanumeric() || "_-.".contains(c);
        // Names of dots only would be folders in addresses.
        let is_dots = name.chars().all(|c| c == '.');
        if is_dots || name.len() > 100 || !name.chars().all(is_plain) {
            let expected = "a name of 1 to 100 letters, digits, _, - and ., not only dots";
            return Err(self.source.refused(&text.name, "patch.name", format!("{name:?}"), expected));
        }
        if let Some(first) = before.iter().find(|patch| patch.name.get_ref() == name) {
            let line = self.source.line_of(&first.name);
            let expected = format!("a name that no other patch has; line {line} has the same");
            return Err(self.source.refused(&text.name, "patch.name", format!("{name:?}"), expected));
        }
        let skin = self.skin(text)?;
        let (link, link_from_patch) = self.mount(text, &skin, &body.kinematics)?;
        let folder = self.source.folder();
        Ok(Patch {
            name: name.clone(),
            line: self.source.line_of(&text.name),
            skin,
            source: text.source.as_ref().map_or_else(|| "twin".to_owned(), |source| source.get_ref().clone()),
            link,
            link_from_patch,
            baseline: text.baseline.clone(),
            calibration: text.calibration.as_ref().map(|path| folder.join(path)),
            forces: text.forces.as_ref().map(|path| folder.join(path)),
        })
    }

    fn skin(&self, text: &PatchText) -> Result<Skin, Error> {
        let name = text.skin.get_ref();
        let opened = match builtin_text(name) {
            Some(_) => Skin::open(name),
            None => Skin::open(&self.source.folder().join(name).display().to_string()),
        };
        let failed = |line: usize| {
            move |source| Error::Skin {
                file: self.source.file.clone(),
                line,
                patch: text.name.get_ref().clone(),
                source,
            }
        };
        let skin = opened.map_err(failed(self.source.line_of(&text.skin)))?;
        match &text.guard {
            Some(guard) => {
                let guarded = Skin { guard: Some(*guard.get_ref()), ..skin };
                guarded.checked().map_err(failed(self.source.line_of(guard)))
            }
            None => Ok(skin),
        }
    }

    /// The link and pose of a patch: from the patch, or else from its skin file.
    fn mount(&self, text: &PatchText, skin: &Skin, kinematics: &Kinematics) -> Result<(usize, Transform), Error> {
        let name = text.name.get_ref();
        for (field, place, most) in [("xyz_mm", &text.xyz_mm, MOST_MM), ("rpy_deg", &text.rpy_deg, 360.0)] {
            if let Some(place) = place
                && let Some(value) = place.get_ref().iter().find(|v| v.is_nan() || v.abs() > most)
            {
                let expected = format!("three numbers from -{most} to {most}");
                return Err(self.source.refused(place, format!("patch {name}: {field}"), value, expected));
            }
        }
        let given = |place: &Option<Spanned<[f64; 3]>>| place.as_ref().map(|place| *place.get_ref());
        let (xyz_mm, rpy_deg) = (given(&text.xyz_mm), given(&text.rpy_deg));
        let has_links = kinematics.link_names().nth(1).is_some();
        let (link, at, xyz_mm, rpy_deg) = match (&text.link, &skin.mount) {
            (Some(link), _) => (link.get_ref().as_str(), link, xyz_mm.unwrap_or_default(), rpy_deg.unwrap_or_default()),
            // A skin file's mount doesn't apply to a body without links.
            (None, Some(mount)) if has_links && xyz_mm.is_none() && rpy_deg.is_none() => {
                (mount.link.as_str(), &text.skin, mount.xyz_mm, mount.rpy_deg)
            }
            (None, _) if !has_links => {
                let root = kinematics.link_name(kinematics.root());
                (root, &text.name, xyz_mm.unwrap_or_default(), rpy_deg.unwrap_or_default())
            }
            (None, _) => {
                let known = listed(kinematics.link_names());
                let expected = format!("a link of the robot: {known}");
                return Err(self.source.refused(&text.name, format!("patch {name}: link"), "left out", expected));
            }
        };
        let number = kinematics.link(link).ok_or_else(|| {
            let known = listed(kinematics.link_names());
            let without = if has_links { "" } else { " (there is no urdf)" };
            self.source.refused(
                at,
                format!("patch {name}: link"),
                format!("{link:?}"),
                format!("a link of the robot: {known}{without}"),
            )
        })?;
        if let Err(joint) = kinematics.joints_of(number) {
            let expected = format!("a link reached through joints with one value each; {joint} has several");
            return Err(self.source.refused(at, format!("patch {name}: link"), format!("{link:?}"), expected));
        }
        Ok((number, mount_transform(xyz_mm, rpy_deg)))
    }
}

/// Pose of a patch on its link, from an offset in millimetres and angles in degrees.
pub fn mount_transform(xyz_mm: Vector, rpy_deg: Vector) -> Transform {
    Transform::from_xyz_rpy(xyz_mm.map(|mm| 1e-3 * mm), rpy_deg.map(f64::to_radians))
}
