// The picture of the skin: the image on a canvas, with a drawing on top in millimetres (x right, y up) of the
// outline, the numbered electrodes, and touches with their trails.

import { Range, paint, table } from "./colour";
import type { Electrode, Image, Point, Scene, Touch } from "./protocol";
import { Rim } from "./rim";
import { SolidView } from "./solid";

const SVG = "http://www.w3.org/2000/svg";
const TRAIL_POINTS = 120;
/** Room above and to the right of the skin, window pixels. */
const MARGIN_PX = 10;
/** Distance between the skin and its axes, window pixels. */
const AXIS_PX = 6;
/** Length of a tick, window pixels. */
const TICK_PX = 4;
/** Height of an axis label, window pixels. */
const LABEL_PX = 11;
/** Width of a digit in an axis label, window pixels. */
const DIGIT_PX = 7;
/** Largest height of electrode numbers, as a share of the distance between two electrodes. */
const NUMBER_SHARE = 0.45;
/** Colours that distinguish touches, here and in their traces: those of Okabe and Ito, also for colour-blind eyes. */
export const TOUCH_COLOURS = ["#e69f00", "#56b4e9", "#d55e00", "#cc79a7", "#009e73", "#0072b2", "#f0e442", "#999999"];

export function touchColour(id: number): string {
  return TOUCH_COLOURS[id % TOUCH_COLOURS.length];
}

export function element<K extends keyof SVGElementTagNameMap>(name: K, attributes: Record<string, string | number>, text?: string): SVGElementTagNameMap[K] {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, String(value));
  if (text !== undefined) made.textContent = text;
  return made;
}

/** The next number in the sequence 1, 2, 5, 10, 20 and so on. */
function roundStep(least: number): number {
  const power = 10 ** Math.floor(Math.log10(Math.max(least, 1e-6)));
  return power * ([1, 2, 5].find((part) => part * power >= least * 0.999) ?? 10);
}

/** An axis label, with as many digits as the step needs. */
function label(value: number, step: number): string {
  return (Math.abs(value) < step / 2 ? 0 : value).toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));
}

interface Drawn {
  group: SVGGElement;
  circle: SVGCircleElement;
  label: SVGTextElement;
  /** An alternative position of the touch, drawn only if the position is ambiguous. */
  other: SVGCircleElement;
  otherLabel: SVGTextElement;
}

/** Smallest distance between two electrodes, millimetres. */
function closest(electrodes: Electrode[]): number {
  let least = Infinity;
  electrodes.forEach(({ position_mm: [x, y] }, index) => {
    for (const { position_mm } of electrodes.slice(0, index)) least = Math.min(least, Math.hypot(x - position_mm[0], y - position_mm[1]));
  });
  return Number.isFinite(least) ? least : 10;
}

/** y grows downwards in the drawing. */
const path = (points: Point[], isClosed: boolean) => points.map(([x, y], index) => `${index ? "L" : "M"}${x} ${-y}`).join("") + (isClosed ? "Z" : "");

export class View {
  readonly range = new Range();
  readonly solid: SolidView;
  private readonly context: CanvasRenderingContext2D;
  private readonly touchLayer = element("g", { class: "touches" });
  private readonly trailLayer = element("g", { class: "trails" });
  private readonly pressLayer = element("g", { class: "presses" });
  private readonly drawn = new Map<number, Drawn>();
  private readonly trails = new Map<number, { points: Point[]; line: SVGPathElement; isLive: boolean }>();
  private pixels: ImageData | null = null;
  private colours = table("viridis");
  private scene: Scene | null = null;
  private rim: Rim | null = null;
  private axisLayer = element("g", { class: "axes" });
  /** Box around outline, image and electrodes, millimetres. */
  private extent = { left: 0, right: 1, bottom: 0, top: 1 };
  private unit = 1;

  constructor(
    readonly stage: HTMLElement,
    private readonly canvas: HTMLCanvasElement,
    readonly overlay: SVGSVGElement,
    private readonly bar: HTMLCanvasElement,
    solid: HTMLCanvasElement,
    /** Canvases on top of the image, aligned pixel by pixel. */
    private readonly over: HTMLCanvasElement[],
  ) {
    this.solid = new SolidView(solid, stage);
    this.context = canvas.getContext("2d")!;
    new ResizeObserver(() => this.place()).observe(stage);
    this.colour("viridis");
  }

  begin(scene: Scene): void {
    this.scene = scene;
    const { grid, outline_mm, electrodes } = scene;
    const points = [...outline_mm.flat(), ...electrodes.flatMap((one) => [one.position_mm, ...one.outline_mm])];
    const xs = [grid.x_min_mm, grid.x_max_mm, ...points.map(([x]) => x)];
    const ys = [grid.y_min_mm, grid.y_max_mm, ...points.map(([, y]) => y)];
    this.extent = { left: Math.min(...xs), right: Math.max(...xs), bottom: Math.min(...ys), top: Math.max(...ys) };
    const { left, right, bottom, top } = this.extent;
    this.unit = Math.max(right - left, top - bottom) / 100;
    this.stage.style.setProperty("--aspect", this.aspect.toFixed(3));
    this.overlay.style.setProperty("--number", String(NUMBER_SHARE * closest(electrodes)));
    this.drawn.clear();
    this.trails.clear();
    for (const layer of [this.touchLayer, this.trailLayer, this.pressLayer]) layer.replaceChildren();
    const outline = element("path", { class: "outline", d: outline_mm.map((ring) => path(ring, true)).join("") });
    const marks = element("g", { class: "electrodes" });
    marks.append(...electrodes.map((one) => this.electrode(one)));
    this.overlay.replaceChildren(this.axisLayer, outline, marks, this.trailLayer, this.touchLayer, this.pressLayer);
    this.range.begin(scene.range_hint);
    this.canvas.width = Math.max(grid.cols, 1);
    this.canvas.height = Math.max(grid.rows, 1);
    this.pixels = null;
    this.rim = new Rim(scene);
    this.solid.begin(scene, touchColour);
    this.place();
  }

  /** Width over height of the skin. */
  get aspect(): number {
    const { left, right, bottom, top } = this.extent;
    return (right - left) / (top - bottom);
  }

  /** Draws an image and returns the range of its colours. */
  draw(image: Image): [number, number] {
    if (this.pixels?.width !== image.cols || this.pixels.height !== image.rows) {
      this.canvas.width = image.cols;
      this.canvas.height = image.rows;
      this.pixels = this.context.createImageData(image.cols, image.rows);
    }
    const range = this.range.update(image.values);
    const words = new Uint32Array(this.pixels.data.buffer);
    paint(image.values, words, this.colours, range);
    this.solid.image(words.slice(), image.rows, image.cols);
    paint(this.rim?.fill(image.values, image.rows, image.cols) ?? image.values, words, this.colours, range);
    this.context.putImageData(this.pixels, 0, 0);
    return range;
  }

  colour(name: "viridis" | "cividis" | "signed"): void {
    this.colours = table(name);
    this.range.isSymmetric = name === "signed";
    const context = this.bar.getContext("2d")!;
    const pixels = context.createImageData(256, 1);
    new Uint32Array(pixels.data.buffer).set(this.colours);
    context.putImageData(pixels, 0, 0);
  }

  touches(touches: Touch[]): void {
    this.solid.touches(touches);
    const live = new Set<number>();
    for (const touch of touches) {
      if (touch.phase === "end") continue;
      live.add(touch.id);
      this.touch(touch);
    }
    for (const [id, { group }] of this.drawn) {
      if (live.has(id)) continue;
      group.remove();
      this.drawn.delete(id);
    }
    this.ageTrails(live);
  }

  /** Shows the presses of mouse, fingers and keys. */
  presses(presses: Iterable<{ x_mm: number; y_mm: number; radius_mm: number; isDown: boolean }>): void {
    const rings = [...presses].map(({ x_mm, y_mm, radius_mm, isDown }) => {
      const group = element("g", { class: isDown ? "press down" : "press" });
      const arm = 1.5 * this.unit;
      group.append(
        element("circle", { cx: x_mm, cy: -y_mm, r: radius_mm }),
        element("path", { d: `M${x_mm - arm} ${-y_mm}h${2 * arm}M${x_mm} ${-y_mm - arm}v${2 * arm}` }),
      );
      return group;
    });
    this.pressLayer.replaceChildren(...rings);
  }

  /** The point of the skin under a window point, millimetres; null in the spatial view, where the mouse rotates. */
  skinFromWindow(clientX: number, clientY: number): Point | null {
    if (this.solid.isShown) return null;
    const matrix = this.overlay.getScreenCTM();
    if (!matrix || !this.scene) return null;
    const point = new DOMPoint(clientX, clientY).matrixTransform(matrix.inverse());
    return [point.x, -point.y];
  }

  /** Fits the skin with its axes into the stage, and aligns the canvases with the image's grid. */
  private place(): void {
    const stage = this.stage.getBoundingClientRect();
    if (!this.scene || stage.width === 0 || stage.height === 0) return;
    const { grid, outline_mm } = this.scene;
    this.fit(stage.width, stage.height);
    const matrix = this.overlay.getScreenCTM();
    if (!matrix) return;
    // Clip along the outline, in window pixels from the image's corner.
    const rings = outline_mm.map((ring) => ring.map(([x, y]): Point => [(x - grid.x_min_mm) * matrix.a, (y - grid.y_max_mm) * matrix.d]));
    const clip = `path(evenodd, "${rings.map((ring) => path(ring, true)).join("")}")`;
    const corner = new DOMPoint(grid.x_min_mm, -grid.y_max_mm).matrixTransform(matrix);
    for (const { style } of [this.canvas, ...this.over]) {
      style.left = `${corner.x - stage.left - this.stage.clientLeft}px`;
      style.top = `${corner.y - stage.top - this.stage.clientTop}px`;
      style.width = `${(grid.x_max_mm - grid.x_min_mm) * matrix.a}px`;
      style.height = `${(grid.y_max_mm - grid.y_min_mm) * matrix.d}px`;
      style.clipPath = rings.length > 0 ? clip : "";
    }
  }

  /** Sets the drawing's scale for a stage of this size, pixels, and draws the axes at that scale. */
  private fit(width: number, height: number): void {
    const { left, right, bottom, top } = this.extent;
    const below = AXIS_PX + TICK_PX + LABEL_PX + MARGIN_PX / 2;
    const step = (mm_per_px: number) => roundStep(Math.max(Math.max(right - left, top - bottom) / 8, 36 * mm_per_px));
    const digits = (mm_per_px: number) => Math.max(2, ...[bottom, top].map((end) => label(end, step(mm_per_px)).length));
    const aside = AXIS_PX + 2 * TICK_PX + DIGIT_PX * digits(this.unit / 4) + 2;
    const mm_per_px = Math.max((right - left) / (width - aside - MARGIN_PX), (top - bottom) / (height - below - MARGIN_PX), 1e-9);
    // Centre the drawing in the stage.
    const [x0, y0] = [
      left - (aside + (width - aside - MARGIN_PX - (right - left) / mm_per_px) / 2) * mm_per_px,
      -top - (MARGIN_PX + (height - below - MARGIN_PX - (top - bottom) / mm_per_px) / 2) * mm_per_px,
    ];
    this.overlay.setAttribute("viewBox", `${x0} ${y0} ${width * mm_per_px} ${height * mm_per_px}`);
    this.overlay.style.setProperty("--px", String(mm_per_px));
    this.axes(step(mm_per_px), mm_per_px);
  }

  /** Millimetre scales along the lower and left edges. */
  private axes(step: number, mm_per_px: number): void {
    const { left, right, bottom, top } = this.extent;
    const [tick, size] = [TICK_PX * mm_per_px, LABEL_PX * mm_per_px];
    const [x0, y0] = [left - AXIS_PX * mm_per_px, -bottom + AXIS_PX * mm_per_px];
    const ticks = (low: number, high: number) => {
      const first = Math.ceil(low / step - 1e-9);
      return Array.from({ length: Math.floor(high / step + 1e-9) - first + 1 }, (_, index) => (first + index) * step);
    };
    const lines = [`M${left} ${y0}H${right}M${x0} ${-bottom}V${-top}`];
    const texts: SVGTextElement[] = [];
    const text = (x: number, y: number, anchor: string, words: string) => texts.push(element("text", { x, y, "font-size": size, "text-anchor": anchor }, words));
    for (const x of ticks(left, right)) {
      lines.push(`M${x} ${y0}v${tick}`);
      text(x, y0 + tick + size, "middle", label(x, step));
    }
    for (const y of ticks(bottom, top)) {
      lines.push(`M${x0} ${-y}h${-tick}`);
      text(x0 - 1.5 * tick, -y + 0.34 * size, "end", label(y, step));
    }
    const last = Math.floor(right / step + 1e-9) * step;
    text(last - step / 2, y0 + tick + size, "middle", "mm");
    this.axisLayer.replaceChildren(element("path", { d: lines.join("") }), ...texts);
  }

  private electrode({ number: electrode, position_mm, outline_mm }: Electrode): SVGGElement {
    const group = element("g", { "data-electrode": electrode });
    const [x, y] = position_mm;
    if (outline_mm.length > 2) group.append(element("path", { d: path(outline_mm, true) }));
    else if (outline_mm.length === 2) group.append(element("path", { class: "segment", d: path(outline_mm, false) }));
    else group.append(element("circle", { cx: x, cy: -y, r: 1.1 * this.unit }));
    // Put the number of a rim segment inside the skin, across from the segment, where nothing covers it.
    let [across, up] = [0, 0];
    if (outline_mm.length === 2) {
      const [[x0, y0], [x1, y1]] = outline_mm;
      const [nx, ny] = [y1 - y0, x0 - x1];
      const length = Math.hypot(nx, ny) * (nx * x + ny * y > 0 ? -1 : 1) || 1;
      [across, up] = [nx / length, ny / length];
    }
    const number = element("text", { class: "number", x, y: -y }, String(electrode));
    number.style.setProperty("--across", across.toFixed(3));
    number.style.setProperty("--down", (-up).toFixed(3));
    group.append(number);
    return group;
  }

  private touch(touch: Touch): void {
    let drawn = this.drawn.get(touch.id);
    if (!drawn) {
      const colour = touchColour(touch.id);
      drawn = {
        group: element("g", { class: "touch", "data-touch": touch.id }),
        circle: element("circle", { stroke: colour }),
        label: element("text", {}),
        other: element("circle", { class: "other", stroke: colour }),
        otherLabel: element("text", {}),
      };
      drawn.group.append(drawn.circle, drawn.label);
      this.touchLayer.append(drawn.group);
      this.drawn.set(touch.id, drawn);
    }
    const { x_mm: x, y_mm: y } = touch;
    const radius = Math.max(Math.sqrt(Math.max(touch.area_mm2, 0) / Math.PI), 1.6 * this.unit);
    this.ring(drawn.circle, drawn.label, [x, y], radius, `${touch.id}: ${x.toFixed(1)}, ${y.toFixed(1)} mm`);
    if (!touch.other) {
      for (const part of [drawn.other, drawn.otherLabel]) part.remove();
    } else {
      if (!drawn.other.isConnected) drawn.group.append(drawn.other, drawn.otherLabel);
      const percent = (100 * touch.other.probability).toFixed(0);
      this.ring(drawn.other, drawn.otherLabel, [touch.other.x_mm, touch.other.y_mm], radius, `${touch.id}? ${percent} %`);
    }
    this.extendTrail(touch);
  }

  private ring(circle: SVGCircleElement, label: SVGTextElement, [x, y]: Point, radius: number, text: string): void {
    circle.setAttribute("cx", String(x));
    circle.setAttribute("cy", String(-y));
    circle.setAttribute("r", String(radius));
    // Put the label on the side with more room.
    const isRight = x > (this.extent.left + this.extent.right) / 2;
    label.setAttribute("x", String(isRight ? x - radius - this.unit : x + radius + this.unit));
    label.setAttribute("y", String(-y + this.unit));
    label.setAttribute("text-anchor", isRight ? "end" : "start");
    if (label.textContent !== text) label.textContent = text;
  }

  private extendTrail({ id, x_mm, y_mm }: Touch): void {
    let trail = this.trails.get(id);
    if (!trail) {
      trail = { points: [], line: element("path", { stroke: touchColour(id) }), isLive: true };
      this.trails.set(id, trail);
      this.trailLayer.append(trail.line);
    }
    trail.points.push([x_mm, y_mm]);
    if (trail.points.length > TRAIL_POINTS) trail.points.shift();
    trail.line.setAttribute("d", path(trail.points, false));
  }

  /** Shortens the trail of a touch that has ended. */
  private ageTrails(live: Set<number>): void {
    for (const [id, trail] of this.trails) {
      if (live.has(id)) continue;
      trail.points.splice(0, 2);
      trail.line.setAttribute("d", path(trail.points, false));
      if (trail.points.length > 1) continue;
      trail.line.remove();
      this.trails.delete(id);
    }
  }
}
