// The picture of the skin: the image on a canvas, with a drawing on top in millimetres (x right, y up) of the
// outline, the numbered electrodes, and touches with their trails.

import { Range, paint, table } from "./colour";
import type { Electrode, Image, Point, Scene, Touch } from "./protocol";
import { Rim } from "./rim";
import { SolidView } from "./solid";

const SVG = "http://www.w3.org/2000/svg";
const TRAIL_POINTS = 120;
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
    const [left, right, bottom, top] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    const size = Math.max(right - left, top - bottom);
    const margin = 0.055 * size;
    // Leave room for the axis labels.
    const axis = 0.06 * size;
    this.unit = size / 100;
    this.overlay.style.setProperty("--unit", String(this.unit));
    this.overlay.setAttribute("viewBox", `${left - margin - axis} ${-top - margin} ${right - left + 2 * margin + axis} ${top - bottom + 2 * margin + axis}`);
    this.drawn.clear();
    this.trails.clear();
    for (const layer of [this.touchLayer, this.trailLayer, this.pressLayer]) layer.replaceChildren();
    const outline = element("path", { class: "outline", d: outline_mm.map((ring) => path(ring, true)).join("") });
    const marks = element("g", { class: "electrodes" });
    marks.append(...electrodes.map((one) => this.electrode(one)));
    const axes = this.axes([left, right], [bottom, top], margin);
    this.overlay.replaceChildren(axes, outline, marks, this.trailLayer, this.touchLayer, this.pressLayer);
    this.range.begin(scene.range_hint);
    this.canvas.width = Math.max(grid.cols, 1);
    this.canvas.height = Math.max(grid.rows, 1);
    this.pixels = null;
    this.rim = new Rim(scene);
    this.solid.begin(scene, touchColour);
    this.place();
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

  /** Aligns the canvas with the image's grid in the drawing. */
  private place(): void {
    const matrix = this.overlay.getScreenCTM();
    if (!matrix || !this.scene) return;
    const { grid, outline_mm } = this.scene;
    const stage = this.stage.getBoundingClientRect();
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

  /** Millimetre scales along the lower and left edges. */
  private axes([left, right]: Point, [bottom, top]: Point, margin: number): SVGGElement {
    const group = element("g", { class: "axes" });
    const step = roundStep(Math.max(right - left, top - bottom) / 8);
    const [tick, size] = [this.unit, 2.8 * this.unit];
    const [x0, y0] = [left - 0.8 * margin, -bottom + 0.8 * margin];
    const ticks = (low: number, high: number) => {
      const first = Math.ceil(low / step - 1e-9);
      return Array.from({ length: Math.floor(high / step + 1e-9) - first + 1 }, (_, index) => (first + index) * step);
    };
    const lines = [`M${left} ${y0}H${right}M${x0} ${-bottom}V${-top}`];
    for (const x of ticks(left, right)) {
      lines.push(`M${x} ${y0}v${tick}`);
      group.append(element("text", { x, y: y0 + tick + size, "font-size": size, "text-anchor": "middle" }, label(x, step)));
    }
    for (const y of ticks(bottom, top)) {
      lines.push(`M${x0} ${-y}h${-tick}`);
      group.append(element("text", { x: x0 - 1.4 * tick, y: -y, dy: "0.34em", "font-size": size, "text-anchor": "end" }, label(y, step)));
    }
    group.append(element("path", { d: lines.join("") }), element("text", { x: x0 - 1.4 * tick, y: y0 + tick + size, "font-size": size, "text-anchor": "end" }, "mm"));
    return group;
  }

  private electrode({ number, position_mm, outline_mm }: Electrode): SVGGElement {
    const group = element("g", { "data-electrode": number });
    const [x, y] = position_mm;
    if (outline_mm.length > 2) group.append(element("path", { d: path(outline_mm, true) }));
    else if (outline_mm.length === 2) group.append(element("path", { class: "segment", d: path(outline_mm, false) }));
    else group.append(element("circle", { cx: x, cy: -y, r: 1.1 * this.unit }));
    // Put the number of a rim segment inside the skin, where nothing covers it.
    const inward = outline_mm.length === 2 ? 1 - (4.2 * this.unit) / Math.max(Math.hypot(x, y), 5 * this.unit) : 1;
    group.append(element("text", { class: "number", x: x * inward, y: -y * inward, "font-size": 3.1 * this.unit, dy: "0.36em" }, String(number)));
    return group;
  }

  private touch(touch: Touch): void {
    let drawn = this.drawn.get(touch.id);
    if (!drawn) {
      const colour = touchColour(touch.id);
      drawn = {
        group: element("g", { class: "touch", "data-touch": touch.id }),
        circle: element("circle", { stroke: colour }),
        label: element("text", { "font-size": 3.1 * this.unit }),
        other: element("circle", { class: "other", stroke: colour }),
        otherLabel: element("text", { "font-size": 3.1 * this.unit }),
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
    const isRight = x > 0;
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
