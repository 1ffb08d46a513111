// Written by a test of crates/dermis-page from its types; protocol.rs says how.

/** The skin as drawn by the page. Lengths are millimetres in the skin's frame. */
export interface Scene {
  /** True if the skin is watched for damage. */
  watches_damage: boolean;
  /** Name of the skin. */
  skin: string;
  /** `eit` or `mit`. */
  modality: string;
  /** True if the skin is a twin, which can be pressed from the page. */
  is_twin: boolean;
  /** True if the twin can be cut and healed. */
  is_treatable: boolean;
  /** Closed rings, without repeating the first point: the outer boundary first, then holes. */
  outline_mm: [number, number][][];
  /** Diameter of the cylinder that the sheet is bent around, with its axis along y; `null` if flat. Other lengths are those of the flattened sheet. */
  bend_diameter_mm: number | null;
  /** Electrodes (or coils) in the order of their numbers. */
  electrodes: ElectrodeView[];
  /** The image's grid. */
  grid: GridView;
  /** Drive and measuring pair of each channel, such as `1-8 / 2-9`. */
  channel_labels: string[];
  /** Unit of channel values and of their noise, such as `V`. */
  channel_unit: string;
  /** Quantity shown by the image, such as `conductivity change`. */
  image_quantity: string;
  /** Unit of the image, such as `S/m`; empty for a ratio. */
  image_unit: string;
  /** Unit of touch amplitudes: the image's, or with a calibration its typical pokes. */
  amplitude_unit: string;
  /** Initial colour range; `null`: from the first frames. */
  range_hint: [number, number] | null;
  /** Range of the hyperparameter's slider. */
  hyperparameter_range: [number, number];
  /** Limits of a press from the page. */
  press: PressLimits;
}

/** One electrode or coil. */
export interface ElectrodeView {
  /** Number shown, from 1. */
  number: number;
  /** Position of the number: the electrode's centre. */
  position_mm: [number, number];
  /** Its outline; empty for a point, two points for a rim segment, more for a polygon. */
  outline_mm: [number, number][];
}

/** Position of the image: the outer edges of its corner pixels. */
export interface GridView {
  /** Rows, the first at the top (largest y). */
  rows: number;
  /** Columns. */
  cols: number;
  /** Left edge. */
  x_min_mm: number;
  /** Right edge. */
  x_max_mm: number;
  /** Lower edge. */
  y_min_mm: number;
  /** Upper edge. */
  y_max_mm: number;
}

/** Ranges of the sliders for pressing a twin; requests outside them are refused. */
export interface PressLimits {
  /** Smallest and largest radius of the indenter. */
  radius_mm: [number, number];
  /** Smallest and largest pressure. */
  pressure_kpa: [number, number];
  /** Initial radius. */
  initial_radius_mm: number;
  /** Initial pressure. */
  initial_pressure_kpa: number;
}

/** The page's content for one frame, except what is binary. */
export interface State {
  /** Number of the update, to be acknowledged. */
  sequence: number;
  /** Frame number. */
  frame: number;
  /** Host monotonic time of the frame's first byte, nanoseconds. Text, like the other times, since JSON readers round integers beyond 2^53. */
  time_ns: string;
  /** The same time on the system's monotonic clock, which all processes of a machine share. */
  monotonic_ns: string;
  /** The same time on the host's wall clock, since 1970-01-01 UTC. */
  wall_ns: string;
  /** The device's own clock, if it has one. */
  device_time_ns: string | null;
  /** Frames per second that leave the pipeline. */
  fps: number;
  /** Touches on the skin, and those that ended in this frame. */
  touches: TouchView[];
  /** Latency of every stage over the last ten seconds, in pipeline order. */
  latency: StageLatency[];
  /** Counters, including losses. */
  counters: Counter[];
  /** State of the pipeline. */
  state: PipelineState;
  /** Faults. */
  health: HealthView;
  /** Classification of the frame by a network, if there is one. */
  classes: ClassState | null;
  /** Damage and baselines, if the skin is watched for damage. */
  damage: DamageView | null;
  /** The guard's verdict, if the skin has a guard. */
  guard: GuardView | null;
}

/** One touch. Positions are in the skin's frame. */
export interface TouchView {
  /** Permanent number of the touch. */
  id: number;
  /** Phase. */
  phase: TouchPhase;
  /** Position along x, millimetres. */
  x_mm: number;
  /** Position along y, millimetres. */
  y_mm: number;
  /** Amplitude in the image's unit. */
  amplitude: number;
  /** Area above half of the peak, square millimetres. */
  area_mm2: number;
  /** Standard deviation of `x_mm`; `null` if unknown. */
  sigma_x_mm: number | null;
  /** Standard deviation of `y_mm`; `null` if unknown. */
  sigma_y_mm: number | null;
  /** Normal force, newtons, if a calibration gives one. */
  force_n: number | null;
  /** Position of `force_n` in its calibration, which ends there if below, above or saturated; `law`: from the law in the skin file. */
  force_range: "within" | "below" | "above" | "saturated" | "law" | "none" | null;
  /** An alternative position, if the calibration cannot decide. */
  other: OtherPlaceView | null;
}

/** Phase of a touch. */
export type TouchPhase =
  /** First frame of the touch. */
  | "begin"
  /** Any later frame with the touch on the skin. */
  | "move"
  /** First frame without it. */
  | "end";

/** An alternative position of a touch. */
export interface OtherPlaceView {
  /** Position along x, millimetres. */
  x_mm: number;
  /** Position along y, millimetres. */
  y_mm: number;
  /** Probability that the touch is here instead. */
  probability: number;
}

/** Latency of one stage, microseconds. */
export interface StageLatency {
  /** Name of the stage. */
  stage: string;
  /** Median. */
  p50_us: number;
  /** 99th percentile. */
  p99_us: number;
}

/** One counter. */
export interface Counter {
  /** Name of the counter. */
  name: string;
  /** Current count. */
  value: number;
  /** True if any value above zero means lost data. */
  is_loss: boolean;
}

/** State of the pipeline. */
export interface PipelineState {
  /** The source. */
  source: SourceState;
  /** The baseline. */
  tare: TareState;
  /** Seconds since the baseline was taken; `null` without one. */
  baseline_age_s: number | null;
  /** File being recorded to, if any. */
  recording: string | null;
  /** Frames recorded to that file. */
  recorded_frames: number;
  /** Hyperparameter in use (the lambda of the skin's prior). */
  hyperparameter: number;
  /** True while the twin shows its demonstration. */
  demonstrates: boolean;
}

/** State of the pipeline's source. */
export type SourceState =
  /** Frames arrive. */
  | { kind: "running" }
  /** Connected but silent, or connecting. */
  | { kind: "waiting"; reason: string }
  /** The connection is lost. */
  | { kind: "lost"; reason: string }
  /** The recording has ended. */
  | { kind: "ended" };

/** State of the baseline. */
export type TareState =
  /** No baseline yet. */
  | { kind: "none" }
  /** A baseline is being averaged. */
  | { kind: "taring"; frames_left: number }
  /** A baseline is in use. */
  | { kind: "tared" };

/** Channels and electrodes that are left out; numbers count from 1. */
export interface HealthView {
  /** Fault of whole frames, during which touches are unknown. */
  frame: FrameFaultView | null;
  /** Number of channels left out, including those of faulty electrodes. */
  left_out: number;
  /** Faulty electrodes (or coils). */
  electrodes: FaultView[];
  /** Channels with faults of their own. */
  channels: FaultView[];
}

/** A fault of whole frames. */
export interface FrameFaultView {
  /** Kind of fault. */
  kind: "frozen" | "saturated" | "flipped" | "out-of-range" | "blank";
  /** Seconds since the first frame that showed it. */
  for_s: number;
}

/** One fault. */
export interface FaultView {
  /** Number of the electrode or channel. */
  number: number;
  /** Kind of fault. */
  kind: "lost" | "shorted" | "inconsistent" | "noisy" | "dead" | "stuck" | "saturated" | "missing";
  /** The other electrode of a short. */
  with: number | null;
  /** Seconds since the first frame that showed it. */
  for_s: number;
}

/** Classification of a frame by a network. */
export interface ClassState {
  /** Distance of the frame from the network's training data; above 1.5 the frame is unlike them. `null` if unknown. */
  novelty: number | null;
  /** True if thresholds on the image replaced the network. */
  falls_back: boolean;
}

/** Damage, and the baselines it is measured against. */
export interface DamageView {
  /** All damages, including suspected and healed ones. */
  list: DamageRow[];
  /** All baselines used, oldest first; the last one is in use now. */
  baselines: BaselineRow[];
  /** Index of the baseline that damage is measured against, from 0. */
  intact: number | null;
  /** A proposal to take a new baseline. */
  proposal: ProposalView | null;
}

/** One damage. Lengths are millimetres in the skin's frame. */
export interface DamageRow {
  /** Permanent number of the damage. */
  id: number;
  /** State of the damage. */
  state: "suspected" | "confirmed" | "covered" | "healing" | "healed";
  /** Centre, x. */
  x_mm: number;
  /** Centre, y. */
  y_mm: number;
  /** Length of a cut; 0 for a spot. */
  length_mm: number;
  /** Direction from +x, counter-clockwise. */
  direction_deg: number;
  /** Both ends. */
  ends_mm: [[number, number], [number, number]];
  /** Largest drop of the image since the damage began. */
  depth: number;
  /** Share that has healed, 0 to 1. */
  healed: number;
  /** Seconds since it was first seen. */
  for_s: number;
}

/** One baseline. */
export interface BaselineRow {
  /** Origin. */
  origin: string;
  /** Reason for taking it. */
  reason: string;
  /** Seconds since it was taken. */
  age_s: number;
}

/** A proposal to take a new baseline. */
export interface ProposalView {
  /** Reason for the proposal. */
  reason: "offset" | "healed" | "touched";
  /** Seconds since the skin came to rest, or since the reason has been known. */
  for_s: number;
  /** Distance of the readings from the baseline, in standard deviations of the channels. */
  offset_sigma: number;
}

/** Verdict of the guard. */
export interface GuardView {
  /** The verdict. */
  verdict: "ok" | "stale" | "stop";
  /** Reasons, unless it is `ok`. */
  reasons: string[];
  /** Always false: no part of dermis is safety-rated. */
  safety_rated: boolean;
}

/** A sign of life, every second. */
export interface Alive {
  /** Number of updates that this page missed. */
  missed: number;
  /** Statistics of all pages. */
  hub: HubStats;
}

/** Statistics on how well the pages keep up. */
export interface HubStats {
  /** Pages connected. */
  clients: number;
  /** Updates published. */
  published: number;
  /** Updates overwritten by a newer one before the server sent any, because frames exceed the page's rate. */
  coalesced: number;
  /** Updates sent to some pages but skipped for a slow one, summed over pages. */
  dropped: number;
}

/** A notice to every page. */
export interface Notice {
  /** Severity. */
  level: Level;
  /** The message. */
  text: string;
}

/** Severity of a notice. */
export type Level =
  /** Normal operation. */
  | "info"
  /** Something that needs attention. */
  | "warning"
  /** A failure, or lost data. */
  | "error";

/** An answer to one request. */
export interface Answer {
  /** Number of the request. */
  id: number;
  /** True if it was carried out. */
  ok: boolean;
  /** The result, or the reason for a refusal. */
  text: string;
}

/** A command from the page. Lengths are millimetres in the skin's frame. */
export type Command =
  /** Take a new baseline; refused under load unless forced. */
  | { tare: { force: boolean } }
  /** Start recording raw frames. */
  | "record_start"
  /** End the recording. */
  | "record_stop"
  /** Use this positive hyperparameter from 0.3 s later. Of several in a row the last counts; the others are answered as replaced. */
  | { hyperparameter: number }
  /** Press on the twin; up to 16 at once per page. */
  | { press: Press }
  /** Move a current press, or change its radius or pressure. */
  | { move: Press }
  /** End a press. The presses of a closed page end too. */
  | { release: { pointer_id: number } }
  /** Treat the twin of a self-healing skin. */
  | { treat: TwinAction }
  /** Stop the twin's demonstration, or show it while nobody presses. */
  | { demonstrate: boolean }
  /** Show these channels (0-based), at most 64. */
  | { choose_channels: number[] };

/** A round indenter on the twin. */
export interface Press {
  /** Identifies the press: unique among all open pages, stable from press to release. */
  pointer_id: number;
  /** Position to the right of the skin's origin. */
  x_mm: number;
  /** Position above the skin's origin. */
  y_mm: number;
  /** Radius of the indenter. */
  radius_mm: number;
  /** Pressure under it, kilopascals. */
  pressure_kpa: number;
}

/** Treatments of a self-healing sheet. */
export type TwinAction =
  /** A cut with a blade. */
  | { cut: { from_mm: [number, number]; to_mm: [number, number] } }
  /** A heat pad laid on the sheet. */
  | { heal: { at_mm: [number, number]; radius_mm: number; temperature_c: number; hours: number } }
  /** Speeds up cuts, heat and their aftermath by this factor from then on. */
  | { "time-lapse": number }
  /** Raises the conductivity of the whole sheet from then on, percent per minute. */
  | { "drift-percent-per-min": number }
  /** Replaces the sheet with a new one. */
  | "renew";
