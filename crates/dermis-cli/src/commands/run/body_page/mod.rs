//! The page of a running body: the robot in space, and a page of its own for each patch.

mod board;
mod meshes;
mod publisher;
mod scene;

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use dermis::body::{BodyWatch, JointsState, StartingPatch};
use dermis_device::HostStamp;
use dermis_page::feed::PageFeed;
use dermis_page::{Announcer, BodyState, JointsView, LinkPoseView, Scene};
use dermis_record::Publisher;

use self::board::PatchBoard;
use self::meshes::Meshes;
use self::publisher::{MOST_REQUESTS, PagePublisher};
use crate::page::{Binding, BodyFeed, BodyPage, Hub, PatchImage, ServerHandle, SkinPage};

/// Collects the parts of the page while the patches start.
pub(super) struct PageOfBody {
    hub: Hub,
    boards: Vec<Arc<PatchBoard>>,
    patches: Vec<Option<SkinPage>>,
}

impl PageOfBody {
    /// The page of a body with this many patches.
    pub fn new(patches: usize) -> Self {
        let boards = (0..patches).map(|_| Arc::default()).collect();
        Self { hub: Hub::new(), boards, patches: (0..patches).map(|_| None).collect() }
    }

    /// The publisher of a patch, for its thread.
    pub fn publisher(&mut self, watch: &BodyWatch, patch: StartingPatch<'_>) -> Box<dyn Publisher> {
        let StartingPatch { number, pipeline, twin, residual_n } = patch;
        let (commands, requests) = crossbeam_channel::bounded(MOST_REQUESTS);
        let mut feed = PageFeed::new(pipeline);
        feed.demonstrate(twin.is_some());
        let hub = Hub::new();
        let scene = dermis_page::scene(pipeline.prepared(), twin.map(|twin| twin.press), pipeline.calibration());
        let board = self.boards[number].clone();
        let before = pipeline.guard_before_frames(HostStamp::now().monotonic_ns);
        board.post(|posted| posted.guard = before);
        self.patches[number] = Some(SkinPage { hub: hub.clone(), scene, commands });
        Box::new(PagePublisher {
            number,
            watch: watch.clone(),
            board,
            twin: twin.cloned(),
            residual_n,
            feed,
            announcer: Announcer::new(&pipeline.prepared().skin),
            hub,
            body_hub: self.hub.clone(),
            requests,
            waiting: VecDeque::new(),
            baselines: 0,
        })
    }

    /// Serves the page of a body that has started.
    pub fn serve(self, binding: Binding, watch: BodyWatch) -> anyhow::Result<ServerHandle> {
        let Self { hub, boards, patches } = self;
        let scenes: Vec<Option<Scene>> =
            patches.iter().map(|patch| patch.as_ref().map(|page| page.scene.clone())).collect();
        let Meshes { shown, meshes, not_drawn } = Meshes::of(watch.body());
        let mut scene = scene::body_scene(watch.body(), watch.sets_joints(), &scenes, &shown);
        scene.not_drawn = not_drawn;
        let feed = Arc::new(BodyOnPage { watch, boards });
        Ok(binding.serve_body(BodyPage { hub, scene, feed, patches, meshes })?)
    }
}

/// A running body as its page sees it.
struct BodyOnPage {
    watch: BodyWatch,
    boards: Vec<Arc<PatchBoard>>,
}

impl BodyFeed for BodyOnPage {
    fn now(&self) -> (BodyState, Vec<PatchImage>) {
        let now_ns = HostStamp::now().monotonic_ns;
        let mut state = self.posture(now_ns);
        let mut newest_ns = 0;
        for (board, health) in self.boards.iter().zip(self.watch.health()) {
            let (view, time_ns, wrench) = board.state(health, now_ns);
            if time_ns >= newest_ns {
                (newest_ns, state.body_wrench) = (time_ns, wrench);
            }
            state.patches.push(view);
        }
        let images = self.boards.iter().enumerate().filter_map(|(patch, board)| board.image(patch)).collect();
        (state, images)
    }

    fn set_joints(&self, values: &BTreeMap<String, f64>) -> Result<(), String> {
        values.iter().try_for_each(|(name, value)| self.watch.set_joint(name, *value))
    }
}

impl BodyOnPage {
    /// Joints and links.
    fn posture(&self, now_ns: u64) -> BodyState {
        let body = self.watch.body();
        let kinematics = &body.kinematics;
        let joints = self.watch.joints_at(now_ns);
        let is_stale = joints.state == JointsState::Stale;
        let known = if is_stale { kinematics.unknown() } else { joints.values.clone() };
        let known = kinematics.root_from_links(&known);
        let drawn = kinematics.root_from_links(&self.watch.posture(&joints.values));
        let links = drawn.into_iter().zip(known).map(|(drawn, known)| LinkPoseView {
            root_from_link: drawn.map(|place| scene::pose(&place)),
            is_known: known.is_some(),
        });
        let value = |name: &str| (name.to_owned(), kinematics.value(&joints.values, name));
        BodyState {
            monotonic_ns: HostStamp::on_system_clock(now_ns).to_string(),
            joints: JointsView {
                state: joints.state.name(),
                age_s: joints.age_s,
                problem: self.watch.joints_problem(),
                values: kinematics.moving_joints().map(value).collect(),
            },
            links: links.collect(),
            ..BodyState::default()
        }
    }
}
