// Tables, badges and messages.

import { brief } from "./charts";
import type { Fault, Health, Notice, Pipeline, Scene, State, Touch } from "./protocol";
import { rows, write } from "./rows";
import { touchColour } from "./view";
import { wordFor, wordForBadge } from "./words";

const MOST_MESSAGES = 50;

const find = (id: string) => document.getElementById(id)!;

/** Outside its calibration a force is only known to be below or above the end of the range. */
function forceSign(range: Touch["force_range"]): string {
  if (range === "below") return "< ";
  return range === "above" || range === "saturated" ? "> " : "";
}

/** Decimal places for a length in millimetres with this standard deviation. */
function placesOf(sigma_mm: number | null): number {
  return sigma_mm !== null && sigma_mm < 0.2 ? 2 : 1;
}

export function showTouches(touches: Touch[]): void {
  const live = touches.filter((touch) => touch.phase !== "end").sort((a, b) => a.id - b.id);
  const texts = live.map((touch): [string, string[]] => {
    const sigmas = [touch.sigma_x_mm, touch.sigma_y_mm].map((sigma) => (sigma === null ? "–" : sigma.toFixed(placesOf(sigma))));
    const force = touch.force_n === null ? "–" : forceSign(touch.force_range) + touch.force_n.toPrecision(3);
    return [String(touch.id), [String(touch.id), touch.x_mm.toFixed(placesOf(touch.sigma_x_mm)), touch.y_mm.toFixed(placesOf(touch.sigma_y_mm)), sigmas.join(" × "), force, brief(touch.amplitude), touch.area_mm2.toFixed(0)]];
  });
  rows(find("touches"), new Map(texts)).forEach((row, index) => {
    const touch = live[index];
    row.dataset.id = String(touch.id);
    row.dataset.phase = touch.phase;
    row.dataset.xMm = touch.x_mm.toFixed(3);
    row.dataset.yMm = touch.y_mm.toFixed(3);
    row.dataset.amplitude = String(touch.amplitude);
    row.style.setProperty("--touch", touchColour(touch.id));
  });
  write(find("touch-count"), String(live.length));
}

function explain(row: HTMLElement, text: string): void {
  if (row.title !== text) row.title = text;
}

export function showLatency(latency: State["latency"]): void {
  const made = rows(find("latency"), new Map(latency.map(({ stage, p50_us, p99_us }) => [stage, [stage, p50_us.toFixed(0), p99_us.toFixed(0)]])));
  made.forEach((row, index) => explain(row, wordFor(latency[index].stage)));
  // An upper bound, since the stages rarely have their worst frame at the same time.
  const sum_us = latency.reduce((sum, { p99_us }) => sum + p99_us, 0);
  write(find("latency-sum"), sum_us >= 1000 ? `${(sum_us / 1000).toFixed(1)} ms` : `${sum_us.toFixed(0)} µs`);
}

export function showCounters(counters: State["counters"]): void {
  const made = rows(find("counters"), new Map(counters.map(({ name, value }) => [name, [name, String(value)]])));
  made.forEach((row, index) => {
    row.dataset.counter = counters[index].name;
    explain(row, wordFor(counters[index].name));
    const { name, value, is_loss } = counters[index];
    const kind = name === "dropped" ? "busy" : "bad";
    row.className = is_loss && value > 0 ? kind : "";
  });
}

const duration = (seconds: number) => (seconds < 120 ? `${seconds.toFixed(0)} s` : `${(seconds / 60).toFixed(0)} min`);

/** Lists the faults in words with their duration, or says that there are none. */
export function showHealth({ frame, left_out, electrodes, channels }: Health, scene: Scene): void {
  const name = scene.modality === "mit" ? "coil" : "electrode";
  const how = ({ kind, with: other }: Fault) => (kind === "shorted" ? `shorted with ${other}` : kind);
  const texts = electrodes.map((fault): [string, string] => [`e${fault.number}`, `${name} ${fault.number} ${how(fault)} for ${duration(fault.for_s)}`]);
  if (frame) texts.unshift(["frame", `all channels ${frame.kind} for ${duration(frame.for_s)}: touches unknown`]);
  for (const fault of channels) {
    const label = scene.channel_labels[fault.number - 1];
    texts.push([`c${fault.number}`, `channel ${fault.number}${label ? ` (${label})` : ""} ${fault.kind} for ${duration(fault.for_s)}`]);
  }
  if (left_out > 0) texts.push(["left", `${left_out} of ${scene.channel_labels.length} channels left out`]);
  if (texts.length === 0) texts.push(["sound", "all channels sound"]);
  const list = find("health");
  const present = new Map([...list.children].map((item) => [(item as HTMLElement).dataset.key, item as HTMLElement]));
  texts.forEach(([key, text], index) => {
    const item = present.get(key) ?? document.createElement("li");
    present.delete(key);
    item.dataset.key = key;
    item.className = key === "sound" ? "" : "bad";
    write(item, text);
    if (list.children[index] !== item) list.insertBefore(item, list.children[index] ?? null);
  });
  for (const item of present.values()) item.remove();
  write(find("strip-health"), texts.length > 1 ? `${texts[0][1]}, and ${texts.length - 1} more` : texts[0][1]);
  find("strip-health").classList.toggle("bad", texts[0][0] !== "sound");
  const lost = new Set(electrodes.map((fault) => String(fault.number)));
  for (const mark of document.querySelectorAll<SVGGElement>(".electrodes [data-electrode]")) {
    mark.classList.toggle("lost", lost.has(mark.dataset.electrode ?? ""));
  }
}

export function showBadges(scene: Scene): void {
  const source = scene.is_twin ? "digital twin" : "measured";
  const texts = [source, scene.modality.toUpperCase(), `${scene.electrodes.length} electrodes`, `${scene.channel_labels.length} channels`, `${scene.grid.cols} × ${scene.grid.rows}`];
  find("badges").replaceChildren(
    ...texts.map((text) => {
      const badge = document.createElement("span");
      badge.className = "badge";
      if (text === source) badge.classList.add("source", scene.is_twin ? "twin" : "real");
      badge.textContent = text;
      badge.title = wordForBadge(text);
      return badge;
    }),
  );
}

export function showPipeline({ source, tare, baseline_age_s, recording, recorded_frames, demonstrates }: Pipeline): void {
  const age = baseline_age_s === null ? "" : `, ${baseline_age_s < 120 ? `${baseline_age_s.toFixed(0)} s` : `${(baseline_age_s / 60).toFixed(0)} min`} old`;
  const left = tare.kind === "taring" ? tare.frames_left : 0;
  const texts = { none: "no baseline", taring: `taring, ${left} frames left`, tared: `baseline${age}` };
  write(find("tare-state"), texts[tare.kind]);
  find("record").setAttribute("aria-pressed", String(recording !== null));
  write(find("record-label"), recording === null ? "Record" : "Stop");
  write(find("record-state"), recording === null ? "" : `${recorded_frames} frames to ${recording}`);
  find("record-state").title = recording ?? "";
  write(find("demo-state"), demonstrates ? "Demonstration: these touches are the twin's own." : "");
  write(find("demo"), demonstrates ? "Stop demonstration" : "Show demonstration");
  find("demo").setAttribute("aria-pressed", String(demonstrates));
  document.body.dataset.source = source.kind;
  if (source.kind !== "running" && document.body.dataset.connection === "live") {
    const text = { waiting: "source waiting", lost: "source lost", ended: "recording ended" }[source.kind];
    const reason = source.kind === "ended" ? "" : source.reason;
    write(find("connection"), reason ? `${text}: ${reason}` : text);
  }
}

function showNewest(item: HTMLElement): void {
  write(find("newest"), item.textContent ?? "");
  find("newest").className = `newest ${item.className}`;
}

export function showMessage(level: Notice["level"], text: string): void {
  const list = find("messages");
  const newest = list.firstElementChild as HTMLElement | null;
  const time = new Date().toLocaleTimeString([], { hour12: false });
  // Count a repeated message instead of listing it again.
  if (newest?.dataset.text === text) {
    const times = Number(newest.dataset.times) + 1;
    newest.dataset.times = String(times);
    newest.textContent = `${time}  ${text} (${times} times)`;
    showNewest(newest);
    return;
  }
  const item = document.createElement("li");
  item.className = level;
  item.dataset.text = text;
  item.dataset.times = "1";
  item.textContent = `${time}  ${text}`;
  list.prepend(item);
  showNewest(item);
  while (list.children.length > MOST_MESSAGES) list.lastElementChild!.remove();
}
