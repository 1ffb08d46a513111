// Names and forces over the robot, as text of the page, so that they stay readable at every zoom. A name is placed off
// its skin along the normal, clear of other names.

import type { Vector3 } from "three";
import { write } from "../rows";
import type { BodyState } from "./protocol";
import type { Robot } from "./robot";
import type { Stage } from "./stage";

/** Distance of a name from its skin, pixels. */
const OFF = 46;
/** Room kept around a name, pixels. */
const GAP = 4;
/** Height of a force, and width of one of its characters, pixels. */
const FORCE_HEIGHT = 15;
const FORCE_DIGIT = 7;
/** Names near the edge of the view move in by this much. */
const EDGE = 6;

interface Box {
  x: number;
  y: number;
  width: number;
  height: number;
}

/** True if a skin with this outward normal shows its back. Arrows on a skin seen from the side stay visible. */
const isAway = (at: Vector3, outward: Vector3, stage: Stage) => outward.dot(stage.camera.position.clone().sub(at).normalize()) < -0.2;

const overlap = (a: Box, b: Box) => Math.abs(a.x - b.x) < (a.width + b.width) / 2 + GAP && Math.abs(a.y - b.y) < (a.height + b.height) / 2 + GAP;

export class Labels {
  private readonly names: { box: HTMLElement; line: SVGLineElement; sizes: [number, number] }[] = [];
  private readonly forces = new Map<string, HTMLElement>();
  private readonly svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");

  constructor(private readonly place: HTMLElement) {}

  begin(robot: Robot): void {
    this.forces.clear();
    this.svg.replaceChildren();
    this.names.length = 0;
    for (const { patch } of robot.skins) {
      const box = document.createElement(patch.running ? "a" : "span");
      if (patch.running) box.setAttribute("href", patch.running.page);
      box.className = "patch-label";
      box.dataset.patch = patch.name;
      const part = (name: string, text = "") => Object.assign(document.createElement("span"), { className: name, textContent: text });
      box.append(part("name", patch.name), ...(patch.running?.is_twin ? [part("badge source twin", "twin")] : []), part("chip state"), part("chip guard"));
      const line = document.createElementNS("http://www.w3.org/2000/svg", "line");
      this.svg.append(line);
      this.names.push({ box, line, sizes: [0, 0] });
    }
    this.place.replaceChildren(this.svg, ...this.names.map(({ box }) => box));
  }

  /** Sets texts and colours. */
  tell(state: BodyState, robot: Robot): void {
    this.names.forEach(({ box, line }, number) => {
      const patch = state.patches[number];
      const isPlaced = state.links[robot.skins[number].patch.link].is_known;
      const [stateChip, guard] = [box.querySelector<HTMLElement>(".state")!, box.querySelector<HTMLElement>(".guard")!];
      const isQuiet = patch.state === "running" && isPlaced;
      stateChip.hidden = isQuiet;
      write(stateChip, patch.state === "running" ? "joints stale" : patch.state);
      stateChip.dataset.level = patch.state === "failed" ? "bad" : patch.state === "ended" || patch.state === "starting" ? "" : "warn";
      guard.hidden = patch.guard === null;
      write(guard, patch.guard?.verdict ?? "");
      guard.dataset.level = patch.guard ? { ok: "good", stale: "warn", stop: "bad" }[patch.guard.verdict] : "";
      line.dataset.level = patch.guard?.verdict === "stop" || patch.state === "failed" ? "bad" : "";
    });
  }

  /** Marks the name of a patch whose row is pointed at; -1 for none. */
  point(patch: number): void {
    this.names.forEach(({ box }, number) => box.classList.toggle("pointed", number === patch));
  }

  /** Moves everything to its position in the next picture. */
  move(robot: Robot, stage: Stage): void {
    const { clientWidth: width, clientHeight: height } = stage.canvas;
    const taken: Box[] = [];
    robot.skins.forEach((skin, number) => {
      const { box, line, sizes } = this.names[number];
      const at = skin.group.localToWorld(skin.middle.clone());
      const outward = skin.normal.clone().transformDirection(skin.group.matrixWorld);
      const [from, to] = [stage.project(at), stage.project(at.clone().addScaledVector(outward, 0.05))];
      const isSeen = from !== null && to !== null && skin.group.parent!.visible;
      box.hidden = !isSeen;
      line.style.display = isSeen ? "" : "none";
      if (!from || !to) return;
      if (sizes[0] === 0 || sizes[0] !== box.offsetWidth) [sizes[0], sizes[1]] = [box.offsetWidth, box.offsetHeight];
      // Along the projected normal, or upwards if it points at the viewer.
      const [dx, dy] = [to.x - from.x, to.y - from.y];
      const length = Math.hypot(dx, dy);
      const [ux, uy] = length > 12 ? [dx / length, dy / length] : [0, -1];
      const [w, h] = sizes;
      const reach = OFF + Math.abs(ux) * (w / 2) + Math.abs(uy) * (h / 2);
      const put: Box = { x: from.x + ux * reach, y: from.y + uy * reach, width: w, height: h };
      const inside = () => {
        put.x = Math.min(Math.max(put.x, w / 2 + EDGE), width - w / 2 - EDGE);
        put.y = Math.min(Math.max(put.y, h / 2 + EDGE), height - h / 2 - EDGE);
      };
      inside();
      for (let tries = 0; tries < 6 && taken.some((other) => overlap(put, other)); tries += 1) {
        put.y += (uy <= 0 ? -1 : 1) * (h + GAP);
        inside();
      }
      taken.push(put);
      box.style.transform = `translate(${(put.x - w / 2).toFixed(1)}px, ${(put.y - h / 2).toFixed(1)}px)`;
      box.classList.toggle("away", isAway(at, outward, stage));
      const ends = { x1: from.x, y1: from.y, x2: put.x, y2: put.y };
      for (const [name, value] of Object.entries(ends)) line.setAttribute(name, value.toFixed(1));
    });
    this.moveForces(robot, stage, taken);
  }

  private moveForces(robot: Robot, stage: Stage, taken: Box[]): void {
    const shown = new Set<string>();
    for (const skin of robot.skins) {
      for (const { key, at, outward, text } of skin.labels()) {
        const seen = stage.project(at);
        if (!seen) continue;
        shown.add(key);
        let label = this.forces.get(key);
        if (!label) {
          label = Object.assign(document.createElement("span"), { className: "force-label" });
          this.forces.set(key, label);
          this.place.append(label);
        }
        write(label, text);
        label.classList.toggle("away", isAway(at, outward, stage));
        const put: Box = { x: seen.x, y: seen.y - 4 - FORCE_HEIGHT / 2, width: FORCE_DIGIT * text.length + 8, height: FORCE_HEIGHT };
        // Next to the end of the arrow if a name is above it.
        if (taken.some((other) => overlap(put, other))) [put.x, put.y] = [seen.x + put.width / 2 + 12, seen.y + FORCE_HEIGHT];
        label.style.transform = `translate(${put.x.toFixed(1)}px, ${put.y.toFixed(1)}px) translate(-50%, -50%)`;
      }
    }
    for (const [key, label] of this.forces) {
      if (shown.has(key)) continue;
      label.remove();
      this.forces.delete(key);
    }
  }
}
