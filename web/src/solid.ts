// Draws a bent skin in space: the image's pixels as quadrilaterals on the bent sheet, in a view that the mouse
// rotates. The cylinder's axis runs along y behind the sheet, as in the skin file; the projection has no perspective.

import type { Point, Scene, Touch } from "./protocol";

type Solid3 = [number, number, number];

/** Rotation per window pixel of dragging, radians. */
const TURN_PER_PIXEL = 0.008;
/** Points on each circle that outlines the cylinder. */
const CIRCLE_POINTS = 96;
/** Steps per edge of the outline, so that it follows the bend. */
const EDGE_STEPS = 24;

export class SolidView {
  isShown = false;
  private readonly context: CanvasRenderingContext2D;
  private scene: Scene | null = null;
  private radius = 0;
  private yaw = -0.5;
  private pitch = 0.35;
  private scale = 1;
  private pixels: Uint32Array | null = null;
  private size: [number, number] = [0, 0];
  private shownTouches: Touch[] = [];
  private colourOf: (id: number) => string = () => "#fff";

  constructor(
    private readonly canvas: HTMLCanvasElement,
    stage: HTMLElement,
  ) {
    this.context = canvas.getContext("2d")!;
    stage.addEventListener("pointermove", (event) => this.turn(event));
    new ResizeObserver(() => this.draw()).observe(stage);
  }

  /** Returns true if the skin is bent; a flat one has no such view. */
  begin(scene: Scene, colourOf: (id: number) => string): boolean {
    this.scene = scene;
    this.colourOf = colourOf;
    this.radius = (scene.bend_diameter_mm ?? 0) / 2;
    this.pixels = null;
    this.shownTouches = [];
    if (this.radius <= 0) this.show(false);
    return this.radius > 0;
  }

  show(isShown: boolean): void {
    this.isShown = isShown;
    this.canvas.hidden = !isShown;
    this.draw();
  }

  /** Takes the colours, one word per pixel as in the flat picture, 0 for none. */
  image(pixels: Uint32Array, rows: number, cols: number): void {
    this.pixels = pixels;
    this.size = [rows, cols];
    this.draw();
  }

  touches(touches: Touch[]): void {
    this.shownTouches = touches.filter((touch) => touch.phase !== "end");
  }

  private turn(event: PointerEvent): void {
    if (!this.isShown || (event.buttons & 1) === 0) return;
    this.yaw += event.movementX * TURN_PER_PIXEL;
    this.pitch = Math.min(Math.max(this.pitch + event.movementY * TURN_PER_PIXEL, -Math.PI / 2), Math.PI / 2);
    this.draw();
  }

  /** A point of the flattened sheet in space: x to the right, y up, z to the viewer, from the cylinder's centre. */
  private bend(x: number, y: number): Solid3 {
    const angle = x / this.radius;
    return [this.radius * Math.sin(angle), y, this.radius * Math.cos(angle)];
  }

  /** Projects a point in space to the screen, with its depth. */
  private project([x, y, z]: Solid3): Solid3 {
    const [sine, cosine] = [Math.sin(this.yaw), Math.cos(this.yaw)];
    const [across, depth] = [x * cosine + z * sine, z * cosine - x * sine];
    const [tilt, level] = [Math.sin(this.pitch), Math.cos(this.pitch)];
    const [up, near] = [y * level - depth * tilt, depth * level + y * tilt];
    return [this.canvas.width / 2 + this.scale * across, this.canvas.height / 2 - this.scale * up, near];
  }

  private draw(): void {
    if (!this.isShown || !this.scene) return;
    const { canvas, context } = this;
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    context.clearRect(0, 0, width, height);
    const { y_min_mm, y_max_mm } = this.scene.grid;
    // Fits inside at every rotation.
    this.scale = (0.46 * Math.min(width, height)) / Math.hypot(this.radius, (y_max_mm - y_min_mm) / 2);
    context.lineWidth = ratio;
    const ink = getComputedStyle(canvas).color;
    for (const y of [y_min_mm, y_max_mm]) this.circle(y, ink);
    this.quads();
    this.outline(ink);
    this.marks(ratio);
  }

  private circle(y: number, colour: string): void {
    const points = Array.from({ length: CIRCLE_POINTS + 1 }, (_, k) => this.bend((2 * Math.PI * this.radius * k) / CIRCLE_POINTS, y));
    this.line(points, colour, 0.35);
  }

  private line(points: Solid3[], colour: string, alpha: number): void {
    const { context } = this;
    context.globalAlpha = alpha;
    context.strokeStyle = colour;
    context.beginPath();
    for (const point of points) {
      const [x, y] = this.project(point);
      context.lineTo(x, y);
    }
    context.stroke();
    context.globalAlpha = 1;
  }

  /** Draws the image, farthest pixels first. The inner side of the sheet is darker. */
  private quads(): void {
    const { pixels, scene, context } = this;
    if (!pixels || !scene) return;
    const [rows, cols] = this.size;
    const { x_min_mm, x_max_mm, y_min_mm, y_max_mm } = scene.grid;
    const corners: Solid3[] = [];
    for (let row = 0; row <= rows; row += 1) {
      const y = y_max_mm + (row / rows) * (y_min_mm - y_max_mm);
      for (let col = 0; col <= cols; col += 1) corners.push(this.project(this.bend(x_min_mm + (col / cols) * (x_max_mm - x_min_mm), y)));
    }
    const order: { near: number; index: number; at: number }[] = [];
    for (let index = 0; index < rows * cols; index += 1) {
      if (pixels[index] === 0) continue;
      const at = Math.floor(index / cols) * (cols + 1) + (index % cols);
      order.push({ near: corners[at][2] + corners[at + cols + 2][2], index, at });
    }
    order.sort((one, other) => one.near - other.near);
    for (const { index, at } of order) {
      const [a, b, c, d] = [corners[at], corners[at + 1], corners[at + cols + 2], corners[at + cols + 1]];
      // The outer side is visible if the corners run clockwise, since the window's y grows downwards.
      const isOuter = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 0;
      const shade = isOuter ? 1 : 0.45;
      const word = pixels[index];
      const colour = `rgb(${Math.round(shade * (word & 255))} ${Math.round(shade * ((word >> 8) & 255))} ${Math.round(shade * ((word >> 16) & 255))})`;
      context.fillStyle = context.strokeStyle = colour;
      context.beginPath();
      for (const [x, y] of [a, b, c, d]) context.lineTo(x, y);
      context.closePath();
      context.fill();
      // Closes the seams between neighbours.
      context.stroke();
    }
  }

  private outline(colour: string): void {
    for (const ring of this.scene!.outline_mm) {
      const along = ring.flatMap(([x, y], k) => {
        const [toX, toY] = ring[(k + 1) % ring.length];
        return Array.from({ length: EDGE_STEPS + 1 }, (_, step): Point => [x + ((toX - x) * step) / EDGE_STEPS, y + ((toY - y) * step) / EDGE_STEPS]);
      });
      this.line(along.map(([x, y]) => this.bend(x, y)), colour, 0.9);
    }
  }

  /** Draws electrodes as dots and touches as rings, faintly on the far side. */
  private marks(ratio: number): void {
    const { context } = this;
    const alpha = (x: number) => (this.project(this.bend(x, 0))[2] >= this.project([0, 0, 0])[2] ? 1 : 0.25);
    for (const { position_mm } of this.scene!.electrodes) {
      const [x, y] = this.project(this.bend(...position_mm));
      context.globalAlpha = 0.6 * alpha(position_mm[0]);
      context.fillStyle = "#fff";
      context.beginPath();
      context.arc(x, y, 1.5 * ratio, 0, 2 * Math.PI);
      context.fill();
    }
    context.lineWidth = 3 * ratio;
    context.font = `600 ${13 * ratio}px system-ui, sans-serif`;
    for (const { id, x_mm, y_mm, area_mm2 } of this.shownTouches) {
      const radius = Math.sqrt(Math.max(area_mm2, 0) / Math.PI);
      const ring = Array.from({ length: 49 }, (_, k) => this.bend(x_mm + radius * Math.cos((k * Math.PI) / 24), y_mm + radius * Math.sin((k * Math.PI) / 24)));
      this.line(ring, this.colourOf(id), alpha(x_mm));
      const [x, y] = this.project(this.bend(x_mm + radius, y_mm));
      context.globalAlpha = alpha(x_mm);
      context.strokeStyle = "#0b0f13";
      context.fillStyle = "#fff";
      context.strokeText(String(id), x + 4 * ratio, y);
      context.fillText(String(id), x + 4 * ratio, y);
    }
    context.globalAlpha = 1;
  }
}
