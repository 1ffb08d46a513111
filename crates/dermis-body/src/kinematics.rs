//! Forward kinematics: the checked tree of a robot's joints, and the transforms along it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crate::error::{Error, listed};
use crate::transform::{Transform, Vector, scaled};
use crate::urdf::{Joint, JointKind, Urdf};

/// A robot's links and joints as a tree.
#[derive(Clone, Debug)]
pub struct Kinematics {
    links: Vec<TreeLink>,
    joints: Vec<TreeJoint>,
    /// Links with every parent before its children.
    order: Vec<usize>,
    link_numbers: BTreeMap<String, usize>,
    joint_numbers: BTreeMap<String, usize>,
}

#[derive(Clone, Debug)]
struct TreeLink {
    name: String,
    /// The joint that carries this link, and the link that joint is attached to.
    carried_by: Option<(usize, usize)>,
}

#[derive(Clone, Debug)]
struct TreeJoint {
    name: String,
    motion: Motion,
    parent_from_joint: Transform,
    limits: Option<[f64; 2]>,
    /// Joint whose value moves this one, the factor on that value, and an offset: the joint itself, 1 and 0 unless it
    /// mimics another.
    source: usize,
    multiplier: f64,
    offset: f64,
}

#[derive(Clone, Copy, Debug)]
enum Motion {
    Fixed,
    Turn(Vector),
    Slide(Vector),
    Unknown,
}

/// Values of a robot's joints, radians or metres; `None` if unknown. Joints that mimic others have no value of their
/// own.
#[derive(Clone, Debug, PartialEq)]
pub struct JointValues(Vec<Option<f64>>);

/// Result of assigning a value to a joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Assigned {
    /// The value was accepted.
    Taken,
    /// The joint is fixed or mimics another, so it has no value of its own.
    NotItsOwn,
    /// The robot has no such joint.
    Unknown,
}

impl Kinematics {
    /// Checks that the joints of a robot form a tree and that mimicked joints exist. `file` is only used in messages.
    ///
    /// # Errors
    /// [`Error::Urdf`], with the line: two links or joints with the same name, links that do not exist, a link
    /// carried by two joints, a cycle of joints, several root links, or a joint that mimics itself, a missing joint,
    /// or one that moves in several directions.
    pub fn new(urdf: &Urdf, file: &Path) -> Result<Self, Error> {
        let fail = |line: usize, message: String| Error::Urdf { file: file.to_path_buf(), line, message };
        let mut link_numbers = BTreeMap::new();
        for (number, link) in urdf.links.iter().enumerate() {
            if let Some(first) = link_numbers.insert(link.name.clone(), number) {
                let message = format!(
                    "duplicate link {:?}: expected unique names, see line {}",
                    link.name, urdf.links[first].line
                );
                return Err(fail(link.line, message));
            }
        }
        let mut joint_numbers = BTreeMap::new();
        for (number, joint) in urdf.joints.iter().enumerate() {
            if let Some(first) = joint_numbers.insert(joint.name.clone(), number) {
                let message = format!(
                    "duplicate joint {:?}: expected unique names, see line {}",
                    joint.name, urdf.joints[first].line
                );
                return Err(fail(joint.line, message));
            }
        }
        let mut links: Vec<TreeLink> =
            urdf.links.iter().map(|link| TreeLink { name: link.name.clone(), carried_by: None }).collect();
        for (number, joint) in urdf.joints.iter().enumerate() {
            let find = |tag: &str, name: &String| {
                let absent = || {
                    let known = listed(urdf.links.iter().map(|link| link.name.as_str()));
                    fail(
                        joint.line,
                        format!("joint {}: {tag} link {name:?}: expected a link of the file: {known}", joint.name),
                    )
                };
                link_numbers.get(name).copied().ok_or_else(absent)
            };
            let (parent, child) = (find("parent", &joint.parent)?, find("child", &joint.child)?);
            if let Some((other, _)) = links[child].carried_by {
                let other = &urdf.joints[other];
                let message = format!(
                    "joint {} carries link {}: expected one joint to carry it, but {} does (line {})",
                    joint.name, joint.child, other.name, other.line
                );
                return Err(fail(joint.line, message));
            }
            links[child].carried_by = Some((number, parent));
        }
        let order = ordered(&links, urdf).map_err(|(line, message)| fail(line, message))?;
        let joints = (0..urdf.joints.len())
            .map(|number| tree_joint(urdf, &joint_numbers, number))
            .collect::<Result<_, _>>()
            .map_err(|(line, message)| fail(line, message))?;
        Ok(Self { links, joints, order, link_numbers, joint_numbers })
    }

    /// A robot of a single link.
    pub fn of_one_link(name: &str) -> Self {
        Self {
            links: vec![TreeLink { name: name.to_owned(), carried_by: None }],
            joints: Vec::new(),
            order: vec![0],
            link_numbers: [(name.to_owned(), 0)].into(),
            joint_numbers: BTreeMap::new(),
        }
    }

    /// Number of the root link, which no joint carries.
    pub fn root(&self) -> usize {
        self.order[0]
    }

    /// Names of the links, by number.
    pub fn link_names(&self) -> impl Iterator<Item = &str> {
        self.links.iter().map(|link| link.name.as_str())
    }

    /// Name of a link.
    pub fn link_name(&self, link: usize) -> &str {
        &self.links[link].name
    }

    /// Number of a link.
    pub fn link(&self, name: &str) -> Option<usize> {
        self.link_numbers.get(name).copied()
    }

    /// The link that a link's joint is attached to; `None` for the root.
    pub fn parent(&self, link: usize) -> Option<usize> {
        self.links[link].carried_by.map(|(_, parent)| parent)
    }

    /// Names of the joints with values of their own, in file order.
    pub fn moving_joints(&self) -> impl Iterator<Item = &str> {
        self.joints
            .iter()
            .enumerate()
            .filter(|(n, joint)| joint.has_own_value(*n))
            .map(|(_, joint)| joint.name.as_str())
    }

    /// Lower and upper limit of a joint, radians or metres, if it has limits.
    pub fn limits(&self, joint: &str) -> Option<[f64; 2]> {
        self.joints[*self.joint_numbers.get(joint)?].limits
    }

    /// Names of the joints that determine the pose of a link.
    ///
    /// # Errors
    /// The name of a joint on the way that moves in several directions.
    pub fn joints_of(&self, link: usize) -> Result<BTreeSet<&str>, &str> {
        let (mut names, mut link) = (BTreeSet::new(), link);
        while let Some((number, parent)) = self.links[link].carried_by {
            let joint = &self.joints[number];
            match joint.motion {
                Motion::Fixed => {}
                Motion::Unknown => return Err(&joint.name),
                Motion::Turn(_) | Motion::Slide(_) => drop(names.insert(self.joints[joint.source].name.as_str())),
            }
            link = parent;
        }
        Ok(names)
    }

    /// Values for all joints, each unknown.
    pub fn unknown(&self) -> JointValues {
        JointValues(vec![None; self.joints.len()])
    }

    /// Every joint at 0, or at its nearer limit if 0 is outside its range.
    pub fn at_rest(&self) -> JointValues {
        let rest = |joint: &TreeJoint| joint.limits.map_or(0.0, |[lower, upper]| 0f64.clamp(lower, upper));
        JointValues(self.joints.iter().map(|joint| Some(rest(joint))).collect())
    }

    /// Sets a joint's value, radians or metres. Values beyond the limits are accepted, since a robot may be there.
    ///
    /// # Errors
    /// [`Error::Joints`] for a value that is not finite.
    pub fn assign(&self, values: &mut JointValues, joint: &str, value: f64) -> Result<Assigned, Error> {
        let Some(&number) = self.joint_numbers.get(joint) else { return Ok(Assigned::Unknown) };
        if !self.joints[number].has_own_value(number) {
            return Ok(Assigned::NotItsOwn);
        }
        if !value.is_finite() {
            return Err(Error::Joints { message: format!("joint {joint} = {value}: expected a finite number") });
        }
        values.0[number] = Some(value);
        Ok(Assigned::Taken)
    }

    /// Value of a joint, radians or metres, including joints that mimic others; `None` if unknown.
    pub fn value(&self, values: &JointValues, joint: &str) -> Option<f64> {
        self.value_of(values, *self.joint_numbers.get(joint)?)
    }

    fn value_of(&self, values: &JointValues, number: usize) -> Option<f64> {
        let joint = &self.joints[number];
        let value = values.0.get(joint.source).copied().flatten()?;
        Some(joint.multiplier * value + joint.offset)
    }

    /// Pose of a link; `None` if a joint on the way has no value.
    pub fn root_from_link(&self, link: usize, values: &JointValues) -> Option<Transform> {
        let (mut here_from_link, mut here) = (Transform::IDENTITY, link);
        while let Some((number, parent)) = self.links[here].carried_by {
            here_from_link = self.parent_from_child(number, values)? * here_from_link;
            here = parent;
        }
        Some(here_from_link)
    }

    /// Poses of all links, by number, with one product each.
    pub fn root_from_links(&self, values: &JointValues) -> Vec<Option<Transform>> {
        let mut all = vec![None; self.links.len()];
        for &link in &self.order {
            all[link] = match self.links[link].carried_by {
                None => Some(Transform::IDENTITY),
                Some((number, parent)) => {
                    all[parent].and_then(|root: Transform| Some(root * self.parent_from_child(number, values)?))
                }
            };
        }
        all
    }

    /// Pose of a link relative to its parent; `None` for the root, or if the joint between them has no value.
    pub fn parent_from_link(&self, link: usize, values: &JointValues) -> Option<Transform> {
        let (number, _) = self.links[link].carried_by?;
        self.parent_from_child(number, values)
    }

    fn parent_from_child(&self, number: usize, values: &JointValues) -> Option<Transform> {
        let joint = &self.joints[number];
        let moved = match joint.motion {
            Motion::Fixed => return Some(joint.parent_from_joint),
            Motion::Turn(axis) => Transform::turn(axis, self.value_of(values, number)?),
            Motion::Slide(axis) => Transform::shift(scaled(axis, self.value_of(values, number)?)),
            Motion::Unknown => return None,
        };
        Some(joint.parent_from_joint * moved)
    }
}

impl TreeJoint {
    fn has_own_value(&self, number: usize) -> bool {
        self.source == number && matches!(self.motion, Motion::Turn(_) | Motion::Slide(_))
    }
}

/// Links ordered so that every parent precedes its children; on failure the line and the fault.
fn ordered(links: &[TreeLink], urdf: &Urdf) -> Result<Vec<usize>, (usize, String)> {
    let mut roots = (0..links.len()).filter(|&link| links[link].carried_by.is_none());
    let Some(root) = roots.next() else {
        return Err((urdf.links[0].line, "every link is carried by another: expected one that is the root".into()));
    };
    if let Some(second) = roots.next() {
        let message = format!(
            "links {} (line {}) and {} are carried by no joint: expected one root",
            links[root].name, urdf.links[root].line, links[second].name
        );
        return Err((urdf.links[second].line, message));
    }
    let mut children = vec![Vec::new(); links.len()];
    for (link, tree_link) in links.iter().enumerate() {
        if let Some((_, parent)) = tree_link.carried_by {
            children[parent].push(link);
        }
    }
    let mut order = vec![root];
    let mut next = 0;
    while next < order.len() {
        order.extend_from_slice(&children[order[next]]);
        next += 1;
    }
    if order.len() == links.len() {
        return Ok(order);
    }
    let reached: BTreeSet<usize> = order.into_iter().collect();
    let lost = (0..links.len()).find(|link| !reached.contains(link)).unwrap_or(root);
    let message =
        format!("link {}: its joints form a cycle: expected them to lead to {}", links[lost].name, links[root].name);
    Err((urdf.links[lost].line, message))
}

/// A joint with its mimicry resolved; on failure the line and the fault.
fn tree_joint(urdf: &Urdf, numbers: &BTreeMap<String, usize>, number: usize) -> Result<TreeJoint, (usize, String)> {
    let joint = &urdf.joints[number];
    let fail = |message: String| (joint.line, format!("joint {}: {message}", joint.name));
    let (mut source, mut multiplier, mut offset) = (number, 1.0, 0.0);
    let moves = |joint: &Joint| !matches!(joint.kind, JointKind::Fixed | JointKind::Other);
    for _ in 0..=urdf.joints.len() {
        let Some(mimic) = urdf.joints[source].mimic.as_ref().filter(|_| moves(&urdf.joints[source])) else {
            let motion = match joint.kind {
                JointKind::Fixed => Motion::Fixed,
                JointKind::Revolute | JointKind::Continuous => Motion::Turn(joint.axis),
                JointKind::Prismatic => Motion::Slide(joint.axis),
                JointKind::Other => Motion::Unknown,
            };
            if source != number && !moves(&urdf.joints[source]) {
                let other = &urdf.joints[source].name;
                return Err(fail(format!("mimics {other}: expected a joint that turns or slides")));
            }
            let (name, limits) = (joint.name.clone(), joint.limits);
            let parent_from_joint = joint.parent_from_joint;
            return Ok(TreeJoint { name, motion, parent_from_joint, limits, source, multiplier, offset });
        };
        // multiplier * (m * value + o) + offset
        offset += multiplier * mimic.offset;
        multiplier *= mimic.multiplier;
        let absent = || fail(format!("mimics {:?}: expected a joint of the file", mimic.joint));
        source = *numbers.get(&mimic.joint).ok_or_else(absent)?;
    }
    Err(fail("mimics joints that form a cycle: expected one that moves by itself".to_owned()))
}
