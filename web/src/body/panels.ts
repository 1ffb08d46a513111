// The lists next to the robot: patches, touches, joints, messages.

import { rows, write } from "../rows";
import type { BodyConnection, BodyScene, BodyState, BodyTouch, Guard, Joint, Patch, PatchState } from "./protocol";
import type { Robot } from "./robot";

const MOST_MESSAGES = 50;
/** Columns of the list of patches. */
const PATCH_CELLS = 7;
/** A slider that the user has moved keeps its value for this long, until the server reports the same value. */
const HOLD_MS = 600;

/** Longest list of meshes that is open at first. */
const MOST_OPEN = 3;

const find = <T extends HTMLElement = HTMLElement>(id: string) => document.getElementById(id) as T;
const RANK = { ok: 0, stale: 1, stop: 2 };

/** A few digits, without an exponent where that is short. */
function brief(value: number): string {
  return Math.abs(value) >= 1e-3 && Math.abs(value) < 1e4 ? String(Number(value.toPrecision(2))) : value.toExponential(1);
}

/** The worst verdict; null if no patch has a guard. */
function worst(patches: PatchState[]): Guard | null {
  const guards = patches.flatMap(({ guard }) => (guard ? [guard] : []));
  return guards.reduce<Guard | null>((most, guard) => (most && RANK[most.verdict] >= RANK[guard.verdict] ? most : guard), null);
}

export class Panels {
  private scene: BodyScene | null = null;
  private patchRows: HTMLTableRowElement[] = [];
  private readonly sliders = new Map<string, { input: HTMLInputElement; movedAt: number }>();
  /** Called when the pointer enters a patch's row, or with -1 when it leaves. */
  pointed: (patch: number) => void = () => {};

  constructor(private readonly connection: () => BodyConnection) {}

  begin(scene: BodyScene): void {
    this.scene = scene;
    write(find("body-name"), scene.body);
    document.title = `${scene.body} – dermis`;
    write(find("root-name"), scene.root);
    this.listNotDrawn(scene.not_drawn);
    write(find("patch-count"), String(scene.patches.length));
    const twins = scene.patches.filter(({ running }) => running?.is_twin).length;
    const badge = document.createElement("span");
    badge.className = "badge source twin";
    badge.textContent = twins === scene.patches.length ? "digital twins" : `${twins} of ${scene.patches.length} are twins`;
    find("badges").replaceChildren(...(twins > 0 ? [badge] : []));
    this.patchRows = scene.patches.map((patch, number) => this.patchRow(patch, number));
    const problem = () => {
      const row = Object.assign(document.createElement("tr"), { className: "problem", hidden: true });
      row.insertCell().colSpan = PATCH_CELLS;
      return row;
    };
    find("patches").replaceChildren(...this.patchRows.flatMap((row) => [row, problem()]));
    find("signed-legend").hidden = !scene.patches.some(({ running }) => (running?.range_hint?.[0] ?? 0) < 0);
    this.beginJoints(scene);
  }

  /** Lists the meshes that are not drawn; a long list opens on request, so that it leaves room for the robot. */
  private listNotDrawn(reasons: string[]): void {
    const list = find<HTMLDetailsElement>("not-drawn");
    list.hidden = reasons.length === 0;
    list.open = reasons.length <= MOST_OPEN;
    write(list.querySelector("summary")!, `${reasons.length} ${reasons.length === 1 ? "mesh is" : "meshes are"} not drawn`);
    list.querySelector("ul")!.replaceChildren(...reasons.map((reason) => Object.assign(document.createElement("li"), { textContent: reason })));
  }

  private beginJoints({ joints, sets_joints }: BodyScene): void {
    find("joints-panel").hidden = joints.length === 0;
    this.sliders.clear();
    find("joints").replaceChildren(
      ...joints.map((joint) => {
        const row = document.createElement("tr");
        row.dataset.joint = joint.name;
        const [name, bar, value] = [row.insertCell(), row.insertCell(), row.insertCell()];
        name.textContent = joint.name;
        const [low, high] = joint.limits ?? [-Math.PI, Math.PI];
        const input = document.createElement("input");
        Object.assign(input, { type: "range", min: String(low), max: String(high), step: String((high - low) / 500), disabled: !sets_joints });
        input.setAttribute("aria-label", joint.name);
        input.addEventListener("input", () => this.move(joint, input));
        bar.append(input);
        value.className = "value";
        this.sliders.set(joint.name, { input, movedAt: -Infinity });
        return row;
      }),
    );
  }

  private move(joint: Joint, input: HTMLInputElement): void {
    this.sliders.get(joint.name)!.movedAt = performance.now();
    this.connection().ask({ joints: { [joint.name]: Number(input.value) } });
  }

  show(state: BodyState, robot: Robot): void {
    if (!this.scene) return;
    this.patches(state, robot);
    this.touches(state);
    this.joints(state);
    const guard = worst(state.patches);
    const verdict = find("verdict");
    verdict.hidden = guard === null;
    if (guard) {
      verdict.dataset.verdict = guard.verdict;
      write(verdict, `guard: ${guard.verdict}`);
    }
    const net = state.body_wrench?.[0];
    write(find("net-force"), net ? `${Math.hypot(...net).toFixed(2)} N` : "–");
    const demo = find("demo");
    demo.hidden = !this.scene.patches.some(({ running }) => running?.is_twin);
    write(demo, state.patches.some(({ demonstrates }) => demonstrates) ? "Stop demonstration" : "Demonstrate");
  }

  private patches(state: BodyState, robot: Robot): void {
    state.patches.forEach((patch, number) => {
      const row = this.patchRows[number];
      this.patchState(row, number, state);
      const [low, high] = robot.skins[number].shownRange;
      const scale = this.scene!.patches[number].running ? (low < 0 ? `± ${brief(high)}` : brief(high)) : "–";
      const p99 = patch.latency_p99_ms === null ? "–" : patch.latency_p99_ms.toFixed(patch.latency_p99_ms < 10 ? 1 : 0);
      const texts = [patch.fps > 0 ? patch.fps.toFixed(1) : "–", p99, String(patch.lost), scale];
      texts.forEach((text, index) => write(row.cells[index + 3], text));
      // A twin skips frames if the computer is too slow; an instrument's frames are lost.
      row.classList.toggle("lossy", patch.lost > 0 && !this.scene!.patches[number].running?.is_twin);
    });
    find("patches").parentElement!.classList.toggle("no-guard", state.patches.every(({ guard }) => guard === null));
  }

  private patchRow(patch: Patch, number: number): HTMLTableRowElement {
    const row = document.createElement("tr");
    for (let cell = 0; cell < PATCH_CELLS; cell += 1) row.insertCell();
    row.dataset.patch = patch.name;
    const name = document.createElement(patch.running ? "a" : "span");
    name.textContent = patch.name;
    if (patch.running) name.setAttribute("href", patch.running.page);
    const kind = document.createElement("span");
    kind.className = patch.running?.is_twin ? "badge source twin" : "badge source";
    kind.textContent = patch.running?.is_twin ? "twin" : patch.skin;
    kind.title = patch.skin;
    row.cells[0].append(name, " ", kind);
    for (const cell of [row.cells[1], row.cells[2]]) cell.append(Object.assign(document.createElement("span"), { className: "chip" }));
    row.addEventListener("pointerenter", () => this.pointed(number));
    row.addEventListener("pointerleave", () => this.pointed(-1));
    return row;
  }

  private patchState(row: HTMLTableRowElement, number: number, state: BodyState): void {
    const [patch, now] = [this.scene!.patches[number], state.patches[number]];
    row.dataset.state = now.state;
    const isPlaced = state.links[patch.link].is_known;
    const [stateChip, guardChip] = [row.cells[1].firstElementChild as HTMLElement, row.cells[2].firstElementChild as HTMLElement];
    write(stateChip, isPlaced || now.state !== "running" ? now.state : "stale");
    stateChip.title = isPlaced ? "" : "Values of joints on the way to its link are unknown or too old";
    stateChip.dataset.level = now.state === "running" ? (isPlaced ? "good" : "warn") : now.state === "failed" ? "bad" : now.state === "silent" ? "warn" : "";
    write(guardChip, now.guard?.verdict ?? "");
    guardChip.dataset.level = now.guard ? { ok: "good", stale: "warn", stop: "bad" }[now.guard.verdict] : "";
    guardChip.title = now.guard?.reasons.join(", ") ?? "";
    const left = now.channels_left_out > 0 ? `${now.channels_left_out} channels left out` : "";
    const problem = row.nextElementSibling as HTMLTableRowElement;
    write(problem.cells[0], [now.problem ?? "", left].filter(Boolean).join("; "));
    problem.dataset.state = now.state;
    problem.hidden = problem.cells[0].textContent === "";
  }

  private touches(state: BodyState): void {
    const live = state.patches.flatMap(({ touches }, number) => touches.filter(({ phase }) => phase !== "end").map((touch): [number, BodyTouch] => [number, touch]));
    write(find("touch-count"), String(live.length));
    const isPlaced = live.every(([, { in_root }]) => in_root !== null);
    write(find("touch-frame"), isPlaced ? `in ${this.scene!.root}'s frame` : "grey: in the patch's frame, joints are stale");
    const cells = live.map(([number, touch]): [string, string[]] => {
      const placed = touch.in_root ?? touch.in_patch;
      const sigma = touch.force_n !== null && touch.sigma_force_n !== null ? ` ± ${touch.sigma_force_n.toFixed(2)}` : "";
      const force = touch.force_n === null ? "–" : touch.force_n.toFixed(2) + sigma;
      const name = `${this.scene!.patches[number].name} ${touch.id}`;
      return [`${number}:${touch.id}`, [name, ...placed.position_mm.map((mm) => mm.toFixed(1)), Math.max(...placed.sigma_mm).toFixed(1), force]];
    });
    rows(find("touches"), new Map(cells)).forEach((row, index) => {
      const [number, touch] = live[index];
      row.dataset.patch = this.scene!.patches[number].name;
      row.dataset.frame = touch.in_root ? "root" : "patch";
      row.dataset.positionMm = (touch.in_root ?? touch.in_patch).position_mm.map((mm) => mm.toFixed(3)).join(" ");
      row.dataset.sigmaMm = (touch.in_root ?? touch.in_patch).sigma_mm.map((mm) => mm.toFixed(3)).join(" ");
      row.dataset.forceN = touch.force_n === null ? "" : String(touch.force_n);
    });
  }

  private joints({ joints }: BodyState): void {
    const chip = find("joints-state");
    write(chip, this.scene!.sets_joints ? "set here" : joints.state);
    chip.dataset.level = joints.state === "stale" ? "warn" : joints.state === "fresh" ? "good" : "";
    const age = joints.age_s !== null && !this.scene!.sets_joints ? `${(1e3 * joints.age_s).toFixed(0)} ms old` : "";
    write(find("joints-age"), [age, joints.problem ?? ""].filter(Boolean).join("; "));
    for (const joint of this.scene!.joints) {
      const value = joints.values[joint.name] ?? null;
      const row = find("joints").querySelector<HTMLElement>(`tr[data-joint=${CSS.escape(joint.name)}]`);
      const { input, movedAt } = this.sliders.get(joint.name)!;
      if (value !== null && performance.now() - movedAt > HOLD_MS) {
        // A continuous joint turns without limit; its slider shows the angle within one turn.
        const shown = joint.limits ? value : Math.atan2(Math.sin(value), Math.cos(value));
        input.value = String(shown);
      }
      const text = value === null ? "unknown" : joint.unit === "m" ? `${(1e3 * value).toFixed(1)} mm` : `${((180 / Math.PI) * value).toFixed(1)}°`;
      write(row!.querySelector(".value")!, text);
    }
  }

  message(level: string, text: string): void {
    const item = document.createElement("li");
    item.className = level;
    item.textContent = `${new Date().toLocaleTimeString()} ${text}`;
    const list = find("messages");
    list.prepend(item);
    while (list.children.length > MOST_MESSAGES) list.lastElementChild!.remove();
  }
}
