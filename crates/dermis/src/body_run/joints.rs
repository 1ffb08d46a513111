//! Joint values of a running body: from JSON lines on standard input, in a file or on a socket, from a ROS 2 topic,
//! from a demonstration, from sliders on the page, or from the body file.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use dermis_body::joint_lines::{MOST_LINE_BYTES, take_line};
use dermis_body::{Assigned, Body, JointSource, JointValues};
use dermis_device::HostStamp;

use crate::error::Error;

/// Period of the demonstration's slowest joint, seconds.
const SWEEP_S: f64 = 12.0;
/// Amplitude of the demonstration for a joint without limits, radians or metres.
const SWEEP_REACH: f64 = 1.0;
/// Maximum number of unknown joints to name; a few are enough to see what is wrong.
const MOST_UNKNOWN: usize = 8;
/// Polling interval of a ROS 2 topic.
#[cfg(feature = "ros2")]
const TOPIC_NAP: Duration = Duration::from_millis(2);
/// Minimum interval between problems in the log: a robot may send a thousand faulty lines a second.
const LOG_EVERY: Duration = Duration::from_secs(10);
/// Delay before reconnecting a lost socket.
const RETRY: Duration = Duration::from_millis(500);

/// The newest joint values.
///
/// No example here: part of the reports of [`BodyRun`](crate::BodyRun).
#[derive(Clone, Debug)]
pub struct JointSnapshot {
    /// The values.
    pub values: JointValues,
    /// State of the values.
    pub state: JointsState,
    /// Age of the values, seconds; `None` if there is no source.
    pub age_s: Option<f64>,
}

/// State of joint values.
///
/// No example here: part of the reports of [`BodyRun`](crate::BodyRun).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointsState {
    /// Fixed values from the body file; there is no source.
    Fixed,
    /// Recent values from the source.
    Fresh,
    /// The source has sent nothing yet, or nothing for longer than the body file allows.
    Stale,
}

impl JointsState {
    /// The state in one word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fixed => "fixed",
            Self::Fresh => "fresh",
            Self::Stale => "stale",
        }
    }
}

/// State shared by the reading thread and its readers.
#[derive(Debug)]
struct Told {
    values: JointValues,
    at_ns: Option<u64>,
    /// Reason for missing values.
    problem: Option<String>,
    /// Joints in the source that the robot does not have.
    unknown: BTreeSet<String>,
    /// Time of the last problem in the log.
    logged: Option<Instant>,
}

impl Told {
    /// Stores a problem, and logs it if the last one in the log is old enough.
    fn report(&mut self, problem: String) {
        if self.logged.is_none_or(|logged| logged.elapsed() >= LOG_EVERY) {
            tracing::warn!("joint values: {problem}");
            self.logged = Some(Instant::now());
        }
        self.problem = Some(problem);
    }

    /// Notes a joint that the robot does not have, and logs it once.
    fn note_unknown(&mut self, joint: String, source: &str) {
        if self.unknown.len() < MOST_UNKNOWN && !self.unknown.contains(&joint) {
            tracing::warn!("joint values: {source}: the robot has no joint {joint:?}");
            self.unknown.insert(joint);
        }
    }
}

/// Kind of source.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Kind {
    Fixed,
    Lines,
    Sweep,
    /// Set by hand, from the page.
    Page,
    /// A ROS 2 topic.
    Ros2,
}

/// Joint values of a running body.
#[derive(Clone, Debug)]
pub struct JointFeed {
    body: Arc<Body>,
    kind: Kind,
    told: Arc<Mutex<Told>>,
    begun: Instant,
}

impl JointFeed {
    /// Opens a source. Without one, the joints stay at `joints.at` or, where that is missing, at rest.
    ///
    /// # Errors
    /// The file or topic cannot be opened.
    pub fn open(body: &Arc<Body>, source: Option<&JointSource>, stop: &Arc<AtomicBool>) -> Result<Self, Error> {
        let kind = match source {
            None => Kind::Fixed,
            Some(JointSource::Sweep) => Kind::Sweep,
            Some(JointSource::Page) => Kind::Page,
            Some(JointSource::Ros2(_)) => Kind::Ros2,
            Some(JointSource::Input | JointSource::Tcp(_) | JointSource::File(_)) => Kind::Lines,
        };
        let values = match kind {
            Kind::Fixed | Kind::Sweep | Kind::Page => rest_where_unknown(body, &body.first_joints),
            Kind::Lines | Kind::Ros2 => body.first_joints.clone(),
        };
        let told = Told { values, at_ns: None, problem: None, unknown: BTreeSet::new(), logged: None };
        let feed = Self { body: body.clone(), kind, told: Arc::new(Mutex::new(told)), begun: Instant::now() };
        let Some(source) = source else { return Ok(feed) };
        let name = if *source == JointSource::Input { "standard input".to_owned() } else { source.to_string() };
        let (reader, stop) = (feed.clone(), stop.clone());
        let work: Box<dyn FnOnce() + Send> = match source {
            JointSource::Sweep | JointSource::Page => return Ok(feed),
            JointSource::Ros2(topic) => return reader.subscribe(topic, stop).map(|()| feed),
            JointSource::Tcp(address) => {
                let address = address.clone();
                Box::new(move || reader.follow_socket(&address, &stop))
            }
            JointSource::Input => Box::new(move || reader.follow(BufReader::new(io::stdin()), false, &name, &stop)),
            JointSource::File(path) => {
                let file = File::open(path).map_err(|error| Error::Joints { name: name.clone(), source: error })?;
                Box::new(move || reader.follow(BufReader::new(file), true, &name, &stop))
            }
        };
        let thread = std::thread::Builder::new().name("dermis-joints".to_owned()).spawn(work);
        // The thread ends with the process or its source, since standard input cannot be interrupted.
        thread.map_err(|error| Error::Joints { name: source.to_string(), source: error })?;
        Ok(feed)
    }

    /// True if the joints never move.
    #[cfg(feature = "ros2")]
    pub fn is_fixed(&self) -> bool {
        self.kind == Kind::Fixed
    }

    /// True if the values come from ROS 2.
    #[cfg(feature = "ros2")]
    pub fn is_of_ros(&self) -> bool {
        self.kind == Kind::Ros2
    }

    /// True if joints are set by hand.
    pub fn is_set_by_hand(&self) -> bool {
        self.kind == Kind::Page
    }

    /// Sets a joint by hand, radians or metres.
    ///
    /// # Errors
    /// The reason for refusing it: the joints have another source, there is no such joint, or its value isn't finite.
    pub fn set(&self, joint: &str, value: f64) -> Result<(), String> {
        if self.kind != Kind::Page {
            return Err(format!("joint {joint} refused: the joints follow their source, not the page"));
        }
        match self.body.kinematics.assign(&mut self.told().values, joint, value) {
            Ok(Assigned::Taken) => Ok(()),
            Ok(Assigned::NotItsOwn) => Err(format!("joint {joint} refused: expected one that moves by itself")),
            Ok(Assigned::Unknown) => Err(format!("joint {joint:?} refused: the robot has no such joint")),
            Err(error) => Err(error.to_string()),
        }
    }

    /// Joint values at a time on the host's monotonic clock.
    pub fn at(&self, now_ns: u64) -> JointSnapshot {
        let told = self.told();
        match self.kind {
            Kind::Fixed => JointSnapshot { values: told.values.clone(), state: JointsState::Fixed, age_s: None },
            Kind::Page => JointSnapshot { values: told.values.clone(), state: JointsState::Fresh, age_s: Some(0.0) },
            Kind::Sweep => {
                let mut values = told.values.clone();
                drop(told);
                self.sweep(&mut values, self.begun.elapsed().as_secs_f64());
                JointSnapshot { values, state: JointsState::Fresh, age_s: Some(0.0) }
            }
            Kind::Lines | Kind::Ros2 => {
                let age_s = told.at_ns.map(|at_ns| 1e-9 * now_ns.saturating_sub(at_ns) as f64);
                let is_fresh = age_s.is_some_and(|age_s| age_s <= self.body.joints_stale_after_s);
                let state = if is_fresh { JointsState::Fresh } else { JointsState::Stale };
                JointSnapshot { values: told.values.clone(), state, age_s }
            }
        }
    }

    /// Reason for missing values, and names of joints that the robot does not have.
    pub fn problem(&self) -> Option<String> {
        let told = self.told();
        let unknown = (!told.unknown.is_empty())
            .then(|| format!("no such joint: {}", told.unknown.iter().cloned().collect::<Vec<_>>().join(", ")));
        let parts: Vec<String> = told.problem.iter().cloned().chain(unknown).collect();
        (!parts.is_empty()).then(|| parts.join("; "))
    }

    /// Follows a ROS 2 topic.
    #[cfg(feature = "ros2")]
    fn subscribe(self, topic: &str, stop: Arc<AtomicBool>) -> Result<(), Error> {
        let name = format!("ros2:{topic}");
        let mut reader = dermis_record::ros2::JointReader::open(topic)?;
        let failed = |source| Error::Joints { name: name.clone(), source };
        let (there, thread) = (name.clone(), std::thread::Builder::new().name("dermis-joints".to_owned()));
        let work = move || {
            while !stop.load(Ordering::Relaxed) {
                match reader.take() {
                    Some(Ok(joints)) => self.assign(&joints, &there),
                    Some(Err(expected)) => self.told().report(format!("{there}: {expected}")),
                    None => std::thread::sleep(TOPIC_NAP),
                }
            }
        };
        thread.spawn(work).map(drop).map_err(failed)
    }

    /// Fails: built without ROS 2.
    #[cfg(not(feature = "ros2"))]
    fn subscribe(self, topic: &str, _stop: Arc<AtomicBool>) -> Result<(), Error> {
        let text = "this dermis was built without ROS 2; expected one built with `--features ros2`";
        let source = io::Error::new(io::ErrorKind::InvalidInput, text);
        Err(Error::Joints { name: format!("ros2:{topic}"), source })
    }

    /// Stores joint values, radians or metres.
    #[cfg(feature = "ros2")]
    fn assign(&self, joints: &[(String, f64)], name: &str) {
        let mut told = self.told();
        told.problem = None;
        for (joint, value) in joints {
            match self.body.kinematics.assign(&mut told.values, joint, *value) {
                Ok(Assigned::Unknown) => told.note_unknown(joint.clone(), name),
                Ok(_) => {}
                Err(error) => told.report(format!("{name}: {error}")),
            }
        }
        if told.problem.is_none() {
            told.at_ns = Some(HostStamp::now().monotonic_ns);
        }
    }

    fn told(&self) -> MutexGuard<'_, Told> {
        self.told.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn sweep(&self, values: &mut JointValues, time_s: f64) {
        let kinematics = &self.body.kinematics;
        for (number, name) in kinematics.moving_joints().enumerate() {
            let [lower, upper] = kinematics.limits(name).unwrap_or([-SWEEP_REACH, SWEEP_REACH]);
            let (middle, reach) = (0.5 * (lower + upper), 0.5 * (upper - lower).min(2.0 * SWEEP_REACH));
            // No two joints move in step, so that every posture occurs.
            let turns = time_s / SWEEP_S * (1.0 + 0.37 * number as f64);
            // Succeeds: the joint exists and the value is finite.
            let _ = kinematics.assign(values, name, middle + reach * (std::f64::consts::TAU * turns).sin());
        }
    }

    fn follow_socket(&self, address: &str, stop: &AtomicBool) {
        while !stop.load(Ordering::Relaxed) {
            match TcpStream::connect(address) {
                Ok(stream) => {
                    self.told().problem = None;
                    self.follow(BufReader::new(stream), false, &format!("tcp:{address}"), stop);
                }
                Err(error) => self.told().report(format!("tcp:{address}: {error}")),
            }
            std::thread::sleep(RETRY);
        }
    }

    /// Reads lines until the input ends.
    fn follow(&self, mut input: impl BufRead, paced: bool, name: &str, stop: &AtomicBool) {
        let (mut line, mut number) = (Vec::new(), 0u64);
        let mut first: Option<(f64, Instant)> = None;
        while !stop.load(Ordering::Relaxed) {
            line.clear();
            number += 1;
            match (&mut input).take(MOST_LINE_BYTES as u64 + 1).read_until(b'\n', &mut line) {
                Ok(0) => {
                    self.told().report(format!("{name} has ended after {} lines", number - 1));
                    return;
                }
                Ok(_) if line.trim_ascii().is_empty() => continue,
                Ok(_) => {}
                Err(error) => {
                    self.told().report(format!("{name}: {error}"));
                    return;
                }
            }
            let mut values = self.told().values.clone();
            let text = String::from_utf8_lossy(&line);
            let taken = take_line(text.trim_end(), &self.body.kinematics, &mut values);
            if let (true, Ok(Some(time_s))) = (paced, taken.as_ref().map(|line| line.time_s)) {
                let (from_s, begun) = *first.get_or_insert((time_s, Instant::now()));
                let due = Duration::try_from_secs_f64(time_s - from_s).unwrap_or_default();
                while begun.elapsed() < due && !stop.load(Ordering::Relaxed) {
                    std::thread::sleep((due - begun.elapsed().min(due)).min(Duration::from_millis(50)));
                }
            }
            let mut told = self.told();
            match taken {
                Ok(line) => {
                    told.values = values;
                    told.problem = None;
                    told.at_ns = Some(HostStamp::now().monotonic_ns);
                    line.unknown.into_iter().for_each(|joint| told.note_unknown(joint, name));
                }
                Err(error) => told.report(format!("{name}, line {number}: {error}")),
            }
        }
    }
}

/// The values, with joints of unknown value at rest.
pub(super) fn rest_where_unknown(body: &Body, told: &JointValues) -> JointValues {
    let kinematics = &body.kinematics;
    let mut values = kinematics.at_rest();
    for name in kinematics.moving_joints() {
        if let Some(value) = kinematics.value(told, name) {
            // Succeeds: the joint exists and the value is finite.
            let _ = kinematics.assign(&mut values, name, value);
        }
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    fn feed(source: Option<JointSource>) -> JointFeed {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in dermis_body::DEMO_FILES {
            std::fs::write(folder.path().join(name), text).unwrap();
        }
        let body = Arc::new(Body::open(&folder.path().join("arm.toml")).unwrap());
        JointFeed::open(&body, source.as_ref(), &Arc::default()).unwrap()
    }

    #[test]
    fn joints_are_set_by_hand_if_the_page_is_their_source() {
        let joints = feed(Some(JointSource::Page));
        assert!(joints.is_set_by_hand());
        joints.set("elbow", 0.7).unwrap();
        let now = joints.at(HostStamp::now().monotonic_ns);
        let value = |name| joints.body.kinematics.value(&now.values, name);
        assert_eq!((now.state, value("elbow"), value("wrist")), (JointsState::Fresh, Some(0.7), Some(0.0)));
        for (name, number, expected) in
            [("knee", 0.0, "no such joint"), ("finger_mirror", 0.0, "moves by itself"), ("elbow", f64::NAN, "finite")]
        {
            let refusal = joints.set(name, number).unwrap_err();
            assert!(refusal.contains(name) && refusal.contains(expected), "{refusal}");
        }
    }

    #[test]
    fn joints_with_a_source_are_not_set_by_hand() {
        for source in [None, Some(JointSource::Sweep)] {
            let refusal = feed(source).set("elbow", 0.7).unwrap_err();
            assert!(refusal.contains("elbow") && refusal.contains("their source"), "{refusal}");
        }
    }
}
