// Treatments of a self-healing skin's twin: cutting with the mouse, healing with a heat pad, time lapse, and a new
// sheet.

import type { Point, Scene, SkinConnection } from "./protocol";
import { type View, element } from "./view";

/** Shorter strokes are slips of the mouse. */
const SHORTEST_CUT_MM = 2;
/** As published: two hours at 90 degrees. */
const HEAT = { temperature_c: 90, hours: 2 };

export type Tool = "press" | "cut" | "heal";

export class Treater {
  tool: Tool = "press";
  private from: Point | null = null;
  private scene: Scene | null = null;
  private readonly mark = element("g", { class: "treatment" });

  constructor(
    private readonly view: View,
    private readonly connection: () => SkinConnection,
    private readonly radius: HTMLInputElement,
  ) {
    const { stage } = view;
    // Capture events before the presser sees them.
    stage.addEventListener("pointerdown", (event) => this.down(event), { capture: true });
    stage.addEventListener("pointermove", (event) => this.move(event), { capture: true });
    stage.addEventListener("pointerup", (event) => this.up(event), { capture: true });
    stage.addEventListener("pointercancel", () => this.leave());
  }

  begin(scene: Scene): void {
    this.scene = scene;
    this.leave();
    this.view.overlay.append(this.mark);
  }

  choose(tool: Tool): void {
    this.tool = tool;
    this.leave();
  }

  timeLapse(factor: number): void {
    this.connection().ask({ treat: { "time-lapse": factor } });
  }

  renew(): void {
    this.connection().ask({ treat: "renew" });
  }

  private place(event: PointerEvent): Point | null {
    return this.tool === "press" || !this.scene?.is_treatable ? null : this.view.skinFromWindow(event.clientX, event.clientY);
  }

  private down(event: PointerEvent): void {
    const place = this.place(event);
    if (!place || event.button !== 0) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    this.view.stage.setPointerCapture(event.pointerId);
    this.from = place;
    this.show(place);
  }

  private move(event: PointerEvent): void {
    const place = this.place(event);
    if (place) this.show(place);
  }

  private up(event: PointerEvent): void {
    const place = this.place(event);
    const from = this.from;
    this.leave();
    if (!place || !from) return;
    event.stopImmediatePropagation();
    if (this.tool === "heal") {
      this.connection().ask({ treat: { heal: { at_mm: place, radius_mm: Number(this.radius.value), ...HEAT } } });
    } else if (Math.hypot(place[0] - from[0], place[1] - from[1]) >= SHORTEST_CUT_MM) {
      this.connection().ask({ treat: { cut: { from_mm: from, to_mm: place } } });
    }
  }

  private show([x, y]: Point): void {
    if (this.tool === "heal") {
      this.mark.replaceChildren(element("circle", { class: "heat", cx: x, cy: -y, r: Number(this.radius.value) }));
    } else if (this.from) {
      const [x0, y0] = this.from;
      this.mark.replaceChildren(element("path", { class: "blade", d: `M${x0} ${-y0}L${x} ${-y}` }));
    }
  }

  private leave(): void {
    this.from = null;
    this.mark.replaceChildren();
  }
}
