// Presses on the twin with mouse, pen, fingers or keys. Updates are sent at most once per display frame and pointer.

import type { Press, Scene, SkinConnection } from "./protocol";
import type { View } from "./view";

/** Pointer id of the keyboard's press, which no browser assigns. */
const KEYS = 0xffffffff;

/** Sets the range of a slider, with a round step of about a hundredth of it. */
function limit(slider: HTMLInputElement, [low, high]: [number, number], initial: number): void {
  slider.step = String(10 ** Math.floor(Math.log10(Math.max(high - low, 1e-6) / 100)));
  slider.min = String(low);
  slider.max = String(high);
  slider.value = String(initial);
  slider.dispatchEvent(new Event("input"));
}

interface Held extends Press {
  isDown: boolean;
  isMoved: boolean;
}

export class Presser {
  /** Further text about a place, after its coordinates. */
  describe: (x_mm: number, y_mm: number) => string = () => "";
  private readonly held = new Map<number, Held>();
  private cursor: Held | null = null;
  /** Position under the mouse, millimetres. */
  private hovered: [number, number] | null = null;
  private scene: Scene | null = null;

  constructor(
    private readonly view: View,
    private readonly connection: () => SkinConnection,
    private readonly radius: HTMLInputElement,
    private readonly pressure: HTMLInputElement,
    private readonly readout: HTMLElement,
  ) {
    const { stage } = view;
    stage.addEventListener("pointerdown", (event) => this.down(event));
    stage.addEventListener("pointermove", (event) => this.move(event));
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"] as const) {
      stage.addEventListener(kind, (event) => this.up(event.pointerId));
    }
    stage.addEventListener("pointerleave", () => {
      this.hovered = null;
      this.readout.textContent = "";
    });
    stage.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    stage.addEventListener("contextmenu", (event) => this.scene?.is_twin && event.preventDefault());
    stage.addEventListener("keydown", (event) => this.key(event));
    stage.addEventListener("blur", () => this.leave());
    for (const slider of [radius, pressure]) slider.addEventListener("input", () => this.resize());
  }

  begin(scene: Scene): void {
    this.scene = scene;
    this.forget();
    const { press } = scene;
    limit(this.radius, press.radius_mm, press.initial_radius_mm);
    limit(this.pressure, press.pressure_kpa, press.initial_pressure_kpa);
  }

  /** Call this after reconnecting: the server has released all presses. */
  forget(): void {
    this.held.clear();
    this.cursor = null;
    this.show();
  }

  /** Releases all presses. */
  release(): void {
    for (const pointer of [...this.held.keys()]) this.up(pointer);
    this.leave();
  }

  /** Sends presses moved since the last display frame, and updates the text for the place under the mouse. */
  flush(): void {
    if (this.hovered) this.tell(this.hovered);
    for (const press of this.held.values()) {
      if (!press.isMoved) continue;
      press.isMoved = false;
      this.connection().ask({ move: this.plain(press) });
    }
  }

  private down(event: PointerEvent): void {
    this.view.stage.focus({ preventScroll: true });
    if (!this.scene?.is_twin || event.button !== 0) return;
    const place = this.view.skinFromWindow(event.clientX, event.clientY);
    if (!place) return;
    event.preventDefault();
    this.view.stage.setPointerCapture(event.pointerId);
    this.cursor = null;
    this.press(event.pointerId, place);
  }

  private press(pointer_id: number, [x_mm, y_mm]: [number, number]): void {
    const held = { pointer_id, x_mm, y_mm, radius_mm: Number(this.radius.value), pressure_kpa: Number(this.pressure.value), isDown: true, isMoved: false };
    this.held.set(pointer_id, held);
    this.connection().ask({ press: this.plain(held) });
    this.show();
  }

  private move(event: PointerEvent): void {
    const place = this.view.skinFromWindow(event.clientX, event.clientY);
    if (!place) return;
    this.hovered = place;
    this.tell(place);
    const held = this.held.get(event.pointerId);
    if (!held) return;
    [held.x_mm, held.y_mm] = place;
    held.isMoved = true;
    this.show();
  }

  private tell([x_mm, y_mm]: [number, number]): void {
    const more = this.describe(x_mm, y_mm);
    const text = `${x_mm.toFixed(1)}, ${y_mm.toFixed(1)} mm${more && `; ${more}`}`;
    if (this.readout.textContent !== text) this.readout.textContent = text;
  }

  private up(pointer_id: number): void {
    if (!this.held.delete(pointer_id)) return;
    this.connection().ask({ release: { pointer_id } });
    this.show();
  }

  private wheel(event: WheelEvent): void {
    if (!this.scene?.is_twin) return;
    event.preventDefault();
    const slider = event.shiftKey ? this.radius : this.pressure;
    this.step(slider, event.deltaY + event.deltaX < 0 ? 1 : -1);
  }

  private step(slider: HTMLInputElement, direction: number): void {
    const span = Number(slider.max) - Number(slider.min);
    slider.value = String(Number(slider.value) + (direction * span) / 20);
    slider.dispatchEvent(new Event("input"));
  }

  /** Applies a new radius or pressure, also to current presses. */
  private resize(): void {
    const [radius_mm, pressure_kpa] = [Number(this.radius.value), Number(this.pressure.value)];
    for (const held of this.held.values()) Object.assign(held, { radius_mm, pressure_kpa, isMoved: true });
    if (this.cursor) Object.assign(this.cursor, { radius_mm, pressure_kpa });
    this.show();
  }

  private key(event: KeyboardEvent): void {
    if (!this.scene?.is_twin || this.view.solid.isShown || event.ctrlKey || event.metaKey || event.altKey) return;
    const size = (this.scene.grid.x_max_mm - this.scene.grid.x_min_mm) / (event.shiftKey ? 100 : 40);
    const steps: Record<string, () => void> = {
      ArrowLeft: () => this.shift(-size, 0),
      ArrowRight: () => this.shift(size, 0),
      ArrowUp: () => this.shift(0, size),
      ArrowDown: () => this.shift(0, -size),
      " ": () => !event.repeat && this.toggle(),
      Enter: () => !event.repeat && this.toggle(),
      Escape: () => this.leave(),
      "+": () => this.step(this.pressure, 1),
      "-": () => this.step(this.pressure, -1),
      "]": () => this.step(this.radius, 1),
      "[": () => this.step(this.radius, -1),
    };
    const step = steps[event.key];
    if (!step) return;
    event.preventDefault();
    event.stopPropagation();
    step();
  }

  private shift(dx: number, dy: number): void {
    const { x_min_mm, x_max_mm, y_min_mm, y_max_mm } = this.scene!.grid;
    const held = this.held.get(KEYS) ?? this.cursorOrNew();
    held.x_mm = Math.min(Math.max(held.x_mm + dx, x_min_mm), x_max_mm);
    held.y_mm = Math.min(Math.max(held.y_mm + dy, y_min_mm), y_max_mm);
    held.isMoved = held.isDown;
    this.hovered = null;
    this.readout.textContent = `${held.x_mm.toFixed(1)}, ${held.y_mm.toFixed(1)} mm`;
    this.show();
  }

  private toggle(): void {
    const held = this.held.get(KEYS);
    if (held) {
      this.cursor = { ...held, isDown: false };
      this.up(KEYS);
    } else {
      const { x_mm, y_mm } = this.cursorOrNew();
      this.cursor = null;
      this.press(KEYS, [x_mm, y_mm]);
    }
  }

  private cursorOrNew(): Held {
    this.cursor ??= { pointer_id: KEYS, x_mm: 0, y_mm: 0, radius_mm: Number(this.radius.value), pressure_kpa: Number(this.pressure.value), isDown: false, isMoved: false };
    return this.cursor;
  }

  private leave(): void {
    this.cursor = null;
    this.up(KEYS);
    this.show();
  }

  private plain({ pointer_id, x_mm, y_mm, radius_mm, pressure_kpa }: Held): Press {
    return { pointer_id, x_mm, y_mm, radius_mm, pressure_kpa };
  }

  private show(): void {
    this.view.presses(this.cursor ? [...this.held.values(), this.cursor] : this.held.values());
  }
}
