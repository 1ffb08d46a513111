// Presses on twins: a twin is pressed where the pointer's ray hits its skin. Elsewhere the pointer rotates the view.

import * as THREE from "three";
import type { Command, Point } from "../protocol";
import type { BodyConnection } from "./protocol";
import type { Robot } from "./robot";
import type { Skin3d } from "./skin3d";
import type { Stage } from "./stage";

interface Held {
  skin: Skin3d;
  at: Point;
  isMoved: boolean;
}

/** Radius and pressure on one skin, which each skin has its own limits for. */
export interface Strength {
  radius_mm: number;
  pressure_kpa: number;
}

export class Presser3d {
  /** Called when a skin is pressed, or its strength is asked for. */
  chosen: (skin: Skin3d) => void = () => {};
  private readonly held = new Map<number, Held>();
  private readonly strengths = new Map<number, Strength>();
  private readonly rays = new THREE.Raycaster();

  constructor(
    private readonly stage: Stage,
    private readonly robot: () => Robot | null,
    private readonly connection: () => BodyConnection,
    private readonly readout: HTMLElement,
  ) {
    const { canvas } = stage;
    // Before the view's own listener, which would turn it.
    canvas.addEventListener("pointerdown", (event) => this.down(event), { capture: true });
    canvas.addEventListener("pointermove", (event) => this.move(event));
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"] as const) canvas.addEventListener(kind, (event) => this.up(event.pointerId));
    canvas.addEventListener("pointerleave", () => (this.readout.textContent = ""));
  }

  strength(skin: Skin3d): Strength {
    const press = skin.patch.running!.press;
    const known = this.strengths.get(skin.number) ?? { radius_mm: press.initial_radius_mm, pressure_kpa: press.initial_pressure_kpa };
    this.strengths.set(skin.number, known);
    return known;
  }

  /** Changes the strength, also of current presses. */
  setStrength(skin: Skin3d, strength: Strength): void {
    this.strengths.set(skin.number, strength);
    for (const held of this.held.values()) held.isMoved ||= held.skin === skin;
  }

  /** Call this after reconnecting: the server has released all presses. */
  forget(): void {
    for (const [pointer, { skin }] of this.held) skin.press(pointer, null);
    this.held.clear();
  }

  /** Sends presses moved since the last picture. */
  flush(): void {
    for (const [pointer, held] of this.held) {
      if (!held.isMoved) continue;
      held.isMoved = false;
      this.ask(held, { move: this.plain(pointer, held) });
      this.mark(pointer, held);
    }
  }

  /** The skin under a point of the window and the place on it, if nothing is in front. */
  meet(x: number, y: number): { skin: Skin3d; at: Point } | null {
    const robot = this.robot();
    if (!robot) return null;
    const box = this.stage.canvas.getBoundingClientRect();
    const place = new THREE.Vector2(((x - box.left) / box.width) * 2 - 1, 1 - ((y - box.top) / box.height) * 2);
    this.rays.setFromCamera(place, this.stage.camera);
    const [first] = this.rays.intersectObjects([...robot.skins.map((skin) => skin.mesh), ...robot.solids], false);
    const skin = first?.object.userData.skin as Skin3d | undefined;
    const at = skin?.sheetOf(first);
    return skin && at ? { skin, at } : null;
  }

  private down(event: PointerEvent): void {
    if (event.button !== 0 || event.shiftKey || event.ctrlKey) return;
    const met = this.meet(event.clientX, event.clientY);
    if (!met?.skin.patch.running?.is_twin) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    this.stage.canvas.setPointerCapture(event.pointerId);
    const held = { ...met, isMoved: false };
    this.held.set(event.pointerId, held);
    this.chosen(met.skin);
    this.ask(held, { press: this.plain(event.pointerId, held) });
    this.mark(event.pointerId, held);
  }

  private move(event: PointerEvent): void {
    if (event.buttons !== 0 && !this.held.has(event.pointerId)) return;
    const met = this.meet(event.clientX, event.clientY);
    this.tell(met);
    const held = this.held.get(event.pointerId);
    // A press that slides off stays at the rim.
    if (!held || met?.skin !== held.skin) return;
    held.at = met.at;
    held.isMoved = true;
    this.stage.touch();
  }

  private up(pointer: number): void {
    const held = this.held.get(pointer);
    if (!held) return;
    this.held.delete(pointer);
    this.ask(held, { release: { pointer_id: pointer } });
    held.skin.press(pointer, null);
    this.stage.touch();
  }

  private tell(met: { skin: Skin3d; at: Point } | null): void {
    this.stage.canvas.classList.toggle("pressable", met?.skin.patch.running?.is_twin ?? false);
    this.readout.textContent = met ? `${met.skin.patch.name}: ${met.at[0].toFixed(1)}, ${met.at[1].toFixed(1)} mm` : "";
  }

  private ask({ skin }: Held, command: Command): void {
    this.connection().ask({ patch: { number: skin.number, command } });
  }

  private plain(pointer_id: number, { skin, at: [x_mm, y_mm] }: Held) {
    return { pointer_id, x_mm, y_mm, ...this.strength(skin) };
  }

  private mark(pointer: number, { skin, at }: Held): void {
    skin.press(pointer, { at, radius_mm: this.strength(skin).radius_mm });
    this.stage.touch();
  }
}
