// The page of a body: connects the robot in space, the lists and the controls. Messages only store the newest data;
// drawing happens once per display frame.

import "../page.css";
import "./body.css";
import * as THREE from "three";
import { Connection, type Link } from "../connection";
import { type Theme, loadSettings, saveSettings } from "../settings";
import { Labels } from "./labels";
import { Panels } from "./panels";
import { Presser3d } from "./press";
import { type BodyConnection, type BodyScene, type BodyState, decodeImage } from "./protocol";
import { Robot } from "./robot";
import type { Skin3d } from "./skin3d";
import { Stage, type ViewName } from "./stage";

/** Lists change at most this often; the picture follows every display frame. */
const PANEL_PERIOD_MS = 66;
const THEMES: Theme[] = ["auto", "light", "dark"];

const find = <T extends HTMLElement = HTMLElement>(id: string) => document.getElementById(id) as T;

let connection: BodyConnection;
let scene: BodyScene | null = null;
let robot: Robot | null = null;
let state: BodyState | null = null;
let isFresh = false;
let isFramed = false;
let chosen: Skin3d | null = null;

const stage = new Stage(find("stage"));
const labels = new Labels(find("labels"));
const panels = new Panels(() => connection);
const presser = new Presser3d(stage, () => robot, () => connection, find("cursor"));

stage.beforeDrawing = () => {
  if (robot && state) labels.move(robot, stage);
};

connection = new Connection({
  link: showLink,
  scene: begin,
  binary: (data) => {
    const image = decodeImage(data);
    if (!image || !robot) return;
    robot.skins[image.patch]?.image(image.values);
    stage.touch();
  },
  state: receive,
  alive: ({ missed }) => (find("missed").textContent = String(missed)),
  notice: ({ level, text }) => panels.message(level, text),
});

function begin(next: BodyScene): void {
  presser.forget();
  // After reconnecting the body may be the same; its view stays.
  const isNew = JSON.stringify(next) !== JSON.stringify(scene);
  scene = next;
  if (!isNew) return;
  robot = new Robot(next);
  robot.loaded = () => stage.moved();
  stage.begin(robot);
  labels.begin(robot);
  panels.begin(next);
  isFramed = false;
  chosen = null;
  const twin = robot.skins.find(({ patch }) => patch.running?.is_twin);
  find("press-controls").hidden = !twin;
  document.body.classList.toggle("of-twin", twin !== undefined);
  if (twin) choose(twin);
}

function receive(next: BodyState): void {
  state = next;
  isFresh = true;
  document.body.dataset.source = "running";
  if (!robot) return;
  robot.show(next);
  labels.tell(next, robot);
  presser.flush();
  stage.moved();
  if (isFramed) return;
  isFramed = true;
  find("wait").hidden = stage.draws;
  find("wait").textContent = "This browser has no WebGL 2, so only the lists are shown.";
  stage.paint();
}

function showLink(link: Link, detail: string): void {
  document.body.dataset.connection = link;
  find("connection").textContent = detail;
}

/** Shows the strength of presses on a skin. */
function choose(skin: Skin3d): void {
  if (chosen === skin) return;
  chosen = skin;
  const { press } = skin.patch.running!;
  find("press-name").textContent = skin.patch.name;
  const strength = presser.strength(skin);
  for (const [id, [low, high], value] of [["radius", press.radius_mm, strength.radius_mm], ["pressure", press.pressure_kpa, strength.pressure_kpa]] as const) {
    const slider = find<HTMLInputElement>(id);
    slider.step = String(10 ** Math.floor(Math.log10(Math.max(high - low, 1e-6) / 100)));
    slider.min = String(low);
    slider.max = String(high);
    slider.value = String(value);
  }
  showStrength();
}

function showStrength(): void {
  for (const [id, unit] of [["radius", "mm"], ["pressure", "kPa"]]) {
    find(`${id}-value`).textContent = `${Number(Number(find<HTMLInputElement>(id).value).toPrecision(3))} ${unit}`;
  }
}

function tellAll(command: { tare: { force: boolean } } | { demonstrate: boolean }, isWanted: (patch: BodyScene["patches"][number]) => boolean): void {
  scene?.patches.forEach((patch, number) => {
    if (isWanted(patch)) connection.ask({ patch: { number, command } });
  });
}

const tare = () => tellAll({ tare: { force: false } }, ({ running }) => running !== null);

function demonstrate(): void {
  const isOn = state?.patches.some(({ demonstrates }) => demonstrates) ?? false;
  tellAll({ demonstrate: !isOn }, ({ running }) => running?.is_twin ?? false);
}

function help(): void {
  const dialog = find<HTMLDialogElement>("help");
  if (dialog.open) dialog.close();
  else dialog.showModal();
}

function bindControls(): void {
  find("tare").addEventListener("click", tare);
  find("demo").addEventListener("click", demonstrate);
  find("help-open").addEventListener("click", help);
  for (const button of document.querySelectorAll<HTMLElement>("[data-view]")) button.addEventListener("click", () => stage.view(button.dataset.view as ViewName));
  for (const id of ["radius", "pressure"]) {
    find(id).addEventListener("input", () => {
      showStrength();
      if (!chosen) return;
      presser.setStrength(chosen, { radius_mm: Number(find<HTMLInputElement>("radius").value), pressure_kpa: Number(find<HTMLInputElement>("pressure").value) });
      presser.flush();
    });
  }
  presser.chosen = choose;
  panels.pointed = (patch) => labels.point(patch);
  document.addEventListener("keydown", (event) => {
    const isTyping = event.target instanceof HTMLInputElement || event.target instanceof HTMLSelectElement;
    if (isTyping || event.ctrlKey || event.metaKey || event.altKey || event.repeat) return;
    const action = { t: tare, "?": help }[event.key.toLowerCase()];
    action?.();
  });
}

function bindTheme(): void {
  const apply = () => {
    const { theme } = loadSettings();
    document.documentElement.dataset.theme = theme;
    find("theme").textContent = `Theme: ${theme}`;
    stage.paint();
  };
  find("theme").addEventListener("click", () => {
    const settings = loadSettings();
    saveSettings({ ...settings, theme: THEMES[(THEMES.indexOf(settings.theme) + 1) % THEMES.length] });
    apply();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => stage.paint());
  apply();
}

function countShown(): void {
  let [since, before] = [performance.now(), 0];
  setInterval(() => {
    const now = performance.now();
    find("shown").textContent = ((1000 * (stage.drawn - before)) / (now - since)).toFixed(1);
    [since, before] = [now, stage.drawn];
  }, 1000);
}

setInterval(() => {
  if (!isFresh || !state || !robot || document.hidden) return;
  isFresh = false;
  panels.show(state, robot);
}, PANEL_PERIOD_MS);

// The token is stored in a cookie by now. Remove it from the address, where it would be copied along.
if (location.search.includes("token=")) history.replaceState(null, "", location.pathname);
bindControls();
bindTheme();
countShown();

/** For tests and debugging: positions in the window and in the root's frame. */
Object.assign(window, {
  dermisBody: {
    state: () => state,
    /** The point of a skin above a place on its flattened sheet: in the root's frame, millimetres, and in the window. */
    place(name: string, x_mm: number, y_mm: number) {
      const skin = robot?.skins.find(({ patch }) => patch.name === name);
      if (!skin) return null;
      const root = skin.group.localToWorld(skin.pointOf([x_mm, y_mm]).at);
      const seen = stage.project(root);
      const box = stage.canvas.getBoundingClientRect();
      const window = seen && { x: box.left + seen.x, y: box.top + seen.y };
      const met = window && presser.meet(window.x, window.y);
      return { root_mm: root.toArray().map((m) => 1e3 * m), window, meets: met ? { patch: met.skin.patch.name, at: met.at } : null };
    },
    look: (x: number, y: number, z: number) => {
      stage.camera.position.copy(stage.controls.target).add(new THREE.Vector3(x, y, z));
      stage.controls.update();
    },
  },
});
