// The live page: connects the connection, the picture, the traces and the controls. Messages only store the newest
// data; drawing happens once per display frame.

import "./page.css";
import { AmplitudeStrip, ChannelStrip, MOST_TRACES, brief, parseChannels } from "./charts";
import type { MapName, RangeMode } from "./colour";
import { ClassOverlay } from "./classes";
import { Connection, type Link } from "./connection";
import { DamagePanel } from "./damage";
import { savePicture, saveTable } from "./keep";
import { Layout } from "./layout";
import { NoiseBars } from "./noise";
import { showBadges, showCounters, showHealth, showLatency, showMessage, showPipeline, showTouches } from "./panels";
import { Presser } from "./press";
import { type Channels, type Classes, type Image, type Scene, type SkinConnection, type State, decode } from "./protocol";
import { type Tool, Treater } from "./treat";
import { View } from "./view";

/** Charts and tables change at most this often; the picture follows every display frame. */
const PANEL_PERIOD_MS = 50;
/** Wider skins get the window's width, with the panels below them. */
const WIDE = 1.8;
/** Number of steps of the hyperparameter's slider, which is logarithmic. */
const SLIDER_STEPS = 1000;

function find<T extends Element = HTMLElement>(id: string): T {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no #${id}`);
  return found as unknown as T;
}

const overlay = new ClassOverlay(find<HTMLCanvasElement>("classes"));
const damage = new DamagePanel();
const view = new View(find("stage"), find<HTMLCanvasElement>("image"), find<SVGSVGElement>("overlay"), find<HTMLCanvasElement>("bar"), find<HTMLCanvasElement>("solid"), [overlay.canvas]);
const amplitudes = new AmplitudeStrip(find("amplitudes"));
const traces = new ChannelStrip(find("traces"));
const noise = new NoiseBars(find<HTMLCanvasElement>("noise"), find("noise-pick"));
const slider = find<HTMLInputElement>("hyperparameter");

/** Name of the patch on a body, if this is one. */
const patch = decodeURIComponent(/\/patch\/([^/]+)\/$/.exec(location.pathname)?.[1] ?? "");

let connection: SkinConnection;
const presser = new Presser(view, () => connection, find<HTMLInputElement>("radius"), find<HTMLInputElement>("pressure"), find("cursor"));

const treater = new Treater(view, () => connection, find<HTMLInputElement>("radius"));

let scene: Scene | null = null;
let classes: Classes | null = null;
let image: Image | null = null;
/** The image on the stage and its colour range; identical to the latest unless the view is paused. */
let shown: { image: Image; state: State | null; range: [number, number] } | null = null;
let channels: Channels | null = null;
let state: State | null = null;
let chosen: number[] = [];
let isFresh = false;
let isStateFresh = false;
let isPaused = false;
let shownImages = 0;
let sliderTouchedAt = -Infinity;

connection = new Connection({
  link: showLink,
  scene: begin,
  binary: receiveBinary,
  state: receiveState,
  alive: ({ missed }) => (find("missed").textContent = String(missed)),
  notice: ({ level, text }) => showMessage(level, text),
});

function begin(next: Scene): void {
  const isNew = JSON.stringify(next) !== JSON.stringify(scene);
  scene = next;
  presser.forget();
  if (!isNew) {
    // After reconnecting, the skin is the same, so keep the user's settings. The server may be a new one.
    if (chosen.length) connection.ask({ choose_channels: chosen });
    return;
  }
  const name = patch ? `${patch} (${next.skin})` : next.skin;
  document.title = `${name} – dermis`;
  find("skin-name").textContent = name;
  showBadges(next);
  view.begin(next);
  presser.begin(next);
  treater.begin(next);
  damage.begin(next, view.overlay);
  classes = null;
  chooseTool("press");
  find("treat-controls").hidden = !next.is_treatable;
  amplitudes.begin();
  noise.begin(next.channel_labels, next.channel_unit);
  find("amplitude-unit").textContent = next.amplitude_unit;
  find("amplitude-head").title = next.amplitude_unit === next.image_unit ? "Height of its peak in the image" : `In ${next.amplitude_unit}, the unit of the calibration, not of the image`;
  for (const id of ["channel-unit", "noise-unit"]) find(id).textContent = next.channel_unit;
  find("range-unit").textContent = [next.image_quantity, next.image_unit && `(${next.image_unit})`].filter(Boolean).join(" ");
  document.querySelector("main")!.classList.toggle("wide", view.aspect > WIDE);
  for (const id of ["press-controls", "demo-controls"]) find(id).hidden = !next.is_twin;
  slider.disabled = !(next.hyperparameter_range[0] > 0 && next.hyperparameter_range[1] > next.hyperparameter_range[0]);
  view.stage.classList.toggle("twin", next.is_twin);
  document.body.classList.toggle("of-twin", next.is_twin);
  showSolid(false);
  find("solid-choice").hidden = !next.bend_diameter_mm;
  chooseChannels();
}

/** Shows the bent skin in space, or flattened. */
function showSolid(isSolid: boolean): void {
  find<HTMLInputElement>("solid-box").checked = isSolid;
  presser.release();
  view.stage.classList.toggle("solid", isSolid);
  view.solid.show(isSolid);
  const help = "Press with mouse or fingers; wheel: pressure, shift + wheel: radius; keys: ?";
  find("stage-help").textContent = isSolid ? "Drag to rotate. To press, use the flat view." : scene?.is_twin ? help : "";
}

function receiveBinary(data: ArrayBuffer): void {
  const message = decode(data);
  if (message?.kind === "image") {
    image = message.image;
    isFresh = true;
  } else if (message?.kind === "channels") channels = message.channels;
  else if (message?.kind === "noise") noise.show(message.noise);
  else if (message?.kind === "classes") classes = message.classes;
}

function receiveState(next: State): void {
  state = next;
  isStateFresh = true;
  if (isPaused) return;
  const time_s = Number(BigInt(next.time_ns) / 1000n) / 1e6;
  amplitudes.push(time_s, next.touches);
  if (channels) traces.push(time_s, channels);
}

function showLink(link: Link, detail: string): void {
  document.body.dataset.connection = link;
  find("connection").textContent = detail;
}

function drawImage(): void {
  presser.flush();
  if (isFresh && image && !isPaused) {
    isFresh = false;
    shownImages += 1;
    const [low, high] = view.draw(image);
    shown = { image, state, range: [low, high] };
    setText("range-low", brief(low));
    setText("range-high", brief(high));
    find("wait").hidden = true;
    if (state) view.touches(state.touches);
    overlay.draw(state?.classes ? classes : null);
  }
  requestAnimationFrame(drawImage);
}

function drawPanels(): void {
  if (!state || !isStateFresh || document.hidden) return;
  isStateFresh = false;
  showPipeline(state.state);
  setText("fps", state.fps.toFixed(1));
  showCounters(state.counters);
  if (scene) showHealth(state.health, scene);
  followHyperparameter(state.state.hyperparameter);
  showClasses(state.classes);
  damage.show(state.damage);
  if (isPaused) return;
  showTouches(state.touches);
  showLatency(state.latency);
  setText("frame", String(state.frame));
  amplitudes.draw();
  traces.draw();
}

function setText(id: string, text: string): void {
  const target = find(id);
  if (target.textContent !== text) target.textContent = text;
}

/** Shows the network's result for the frame, and how far to trust it. */
function showClasses(seen: State["classes"]): void {
  find("classes-choice").hidden = !seen;
  const novelty = seen?.novelty ?? null;
  setText("classes-state", !seen ? "" : seen.falls_back ? "by thresholds" : "by network");
  if (novelty !== null) find("classes-state").title = `Novelty ${novelty.toFixed(2)}; above 1.5 the frame is unlike the training set, so thresholds are used`;
}

function chooseTool(tool: Tool): void {
  find<HTMLSelectElement>("tool").value = tool;
  treater.choose(tool);
}

/** Makes the slider follow the pipeline, except while the user moves it. */
function followHyperparameter(value: number): void {
  if (!scene || performance.now() - sliderTouchedAt < 1000 || !(value > 0)) return;
  setText("hyperparameter-value", value.toExponential(2));
  if (slider.disabled) return;
  const [low, high] = scene.hyperparameter_range.map(Math.log);
  slider.value = String(Math.round((SLIDER_STEPS * (Math.log(value) - low)) / (high - low)));
}

function sendHyperparameter(): void {
  if (!scene) return;
  sliderTouchedAt = performance.now();
  const [low, high] = scene.hyperparameter_range.map(Math.log);
  const value = Math.exp(low + (Number(slider.value) / SLIDER_STEPS) * (high - low));
  setText("hyperparameter-value", value.toExponential(2));
  connection.ask({ hyperparameter: value });
}

function chooseChannels(): void {
  const input = find<HTMLInputElement>("channels");
  const count = scene?.channel_labels.length ?? 0;
  const wanted = parseChannels(input.value, count);
  const isFit = wanted !== null && wanted.length <= MOST_TRACES;
  input.setCustomValidity(isFit ? "" : `expected at most ${MOST_TRACES} numbers from 1 to ${count}`);
  input.title = isFit ? wanted.map((channel) => `${channel + 1}: ${scene?.channel_labels[channel]}`).join("\n") : input.validationMessage;
  if (!isFit || !scene) return;
  chosen = wanted;
  traces.choose(chosen, scene.channel_labels);
  connection.ask({ choose_channels: chosen });
}

function pause(): void {
  isPaused = !isPaused;
  const button = find<HTMLButtonElement>("pause");
  button.setAttribute("aria-pressed", String(isPaused));
  button.textContent = isPaused ? "Resume view" : "Pause view";
  document.body.classList.toggle("paused", isPaused);
}

function keepPicture(): void {
  if (!scene || !shown) return;
  savePicture(scene, shown.image.frame, view.stage, view.overlay, find<HTMLCanvasElement>("bar"), shown.range, find("range-unit").textContent ?? "").catch((error: unknown) => showMessage("error", `no picture: ${error}`));
}

function keepTable(): void {
  if (scene && shown) saveTable(scene, shown.image, shown.state);
}

const tare = (force: boolean) => connection.ask({ tare: { force } });
const record = () => connection.ask(state?.state.recording ? "record_stop" : "record_start");

function help(): void {
  const dialog = find<HTMLDialogElement>("help");
  if (dialog.open) dialog.close();
  else dialog.showModal();
}

function bindControls(): void {
  find("tare").addEventListener("click", () => tare(false));
  find("tare-force").addEventListener("click", () => tare(true));
  find("record").addEventListener("click", record);
  find("pause").addEventListener("click", pause);
  find("keep-png").addEventListener("click", keepPicture);
  find("keep-csv").addEventListener("click", keepTable);
  find("help-open").addEventListener("click", help);
  find("demo").addEventListener("click", () => connection.ask({ demonstrate: !state?.state.demonstrates }));
  find("tool").addEventListener("change", (event) => chooseTool((event.target as HTMLSelectElement).value as Tool));
  find("time-lapse").addEventListener("change", (event) => treater.timeLapse(Number((event.target as HTMLSelectElement).value)));
  find("renew").addEventListener("click", () => treater.renew());
  find("proposal-take").addEventListener("click", () => tare(false));
  presser.describe = (x_mm, y_mm) => {
    if (!scene || !state?.classes) return "";
    const { x_min_mm, x_max_mm, y_min_mm, y_max_mm } = scene.grid;
    return overlay.describe((x_mm - x_min_mm) / (x_max_mm - x_min_mm), (y_max_mm - y_mm) / (y_max_mm - y_min_mm));
  };
  slider.addEventListener("input", () => (sliderTouchedAt = performance.now()));
  slider.addEventListener("input", throttled(sendHyperparameter, 60));
  find("channels").addEventListener("input", chooseChannels);
  for (const [id, unit] of [["radius", "mm"], ["pressure", "kPa"]]) {
    const input = find<HTMLInputElement>(id);
    const show = () => (find(`${id}-value`).textContent = `${Number(Number(input.value).toPrecision(3))} ${unit}`);
    input.addEventListener("input", show);
    show();
  }
  document.addEventListener("keydown", (event) => {
    const isTyping = event.target instanceof HTMLInputElement || event.target instanceof HTMLSelectElement;
    if (isTyping || event.ctrlKey || event.metaKey || event.altKey || event.repeat) return;
    const action = { t: () => tare(false), r: record, p: pause, s: keepPicture, c: keepTable, "?": help }[event.key.toLowerCase()];
    action?.();
  });
}

function bindPicture(): void {
  const { range } = view;
  const [low, high] = [find<HTMLInputElement>("fixed-low"), find<HTMLInputElement>("fixed-high")];
  const redraw = () => (isFresh = image !== null);
  const fix = () => {
    range.fixed = [Number(low.value), Number(high.value)];
    redraw();
  };
  find("range-mode").addEventListener("change", (event) => {
    range.mode = (event.target as HTMLSelectElement).value as RangeMode;
    find("range-fixed").hidden = range.mode !== "fixed";
    if (range.mode === "fixed") {
      [low.value, high.value] = [find("range-low").textContent ?? "0", find("range-high").textContent ?? "1"];
      fix();
    }
    redraw();
  });
  low.addEventListener("input", fix);
  high.addEventListener("input", fix);
  find("range-reset").addEventListener("click", () => {
    range.reset();
    redraw();
  });
  find("colours").addEventListener("change", (event) => {
    view.colour((event.target as HTMLSelectElement).value as MapName);
    redraw();
  });
  find("solid-box").addEventListener("change", (event) => showSolid((event.target as HTMLInputElement).checked));
  for (const id of ["smooth", "numbers", "axes", "trails", "classes-box"]) {
    const box = find<HTMLInputElement>(id);
    const apply = () => view.stage.classList.toggle(`no-${id}`, !box.checked);
    box.addEventListener("change", apply);
    apply();
  }
}

/** Calls at most once per period, and once more with the last arguments. */
function throttled(action: () => void, period_ms: number): () => void {
  let timer: number | undefined;
  return () => {
    timer ??= window.setTimeout(() => {
      timer = undefined;
      action();
    }, period_ms);
  };
}

function countShown(): void {
  let since = performance.now();
  setInterval(() => {
    const now = performance.now();
    setText("shown", ((1000 * shownImages) / (now - since)).toFixed(1));
    [shownImages, since] = [0, now];
  }, 1000);
}

// The token is stored in a cookie by now. Remove it from the address, where it would be copied along.
if (location.search.includes("token=")) history.replaceState(null, "", location.pathname);
document.body.classList.toggle("patch", patch !== "");
// Embedded in another page there is only room for the picture and the touches.
document.body.classList.toggle("embedded", new URLSearchParams(location.search).has("embed"));
bindControls();
bindPicture();
new Layout();
countShown();
setInterval(drawPanels, PANEL_PERIOD_MS);
requestAnimationFrame(drawImage);
