// The noise of every channel as bars on a logarithmic scale; channels far above the median are highlighted.

import { brief } from "./charts";
import { THEME_EVENT } from "./layout";

/** Multiple of the median above which a channel is highlighted. */
const LOUD = 5;

export class NoiseBars {
  private noise: Float32Array = new Float32Array();
  private labels: string[] = [];
  private unit = "";
  private picked: number | null = null;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly readout: HTMLElement,
  ) {
    new ResizeObserver(() => this.draw()).observe(canvas);
    document.addEventListener(THEME_EVENT, () => this.draw());
    canvas.addEventListener("pointermove", (event) => this.pick(event.offsetX / canvas.clientWidth));
    canvas.addEventListener("pointerleave", () => this.pick(null));
  }

  begin(labels: string[], unit: string): void {
    this.labels = labels;
    this.unit = unit;
    this.noise = new Float32Array();
    this.draw();
  }

  show(noise: Float32Array): void {
    this.noise = noise;
    this.draw();
  }

  private pick(place: number | null): void {
    this.picked = place === null || this.noise.length === 0 ? null : Math.min(Math.floor(place * this.noise.length), this.noise.length - 1);
    this.draw();
  }

  private draw(): void {
    const { canvas, noise } = this;
    const ratio = devicePixelRatio;
    const [width, height] = [canvas.clientWidth * ratio, canvas.clientHeight * ratio];
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
    const context = canvas.getContext("2d")!;
    context.clearRect(0, 0, width, height);
    const known = Array.from(noise).filter((value) => value > 0 && Number.isFinite(value)).sort((a, b) => a - b);
    if (known.length === 0) {
      this.readout.textContent = noise.length ? "noise unknown" : "not measured yet";
      return;
    }
    const median = known[known.length >> 1];
    const [low, high] = [Math.log10(known[0]) - 0.3, Math.log10(known[known.length - 1]) + 0.1];
    const style = getComputedStyle(document.documentElement);
    const [plain, loud, missing] = ["--accent", "--bad", "--line"].map((name) => style.getPropertyValue(name).trim());
    const step = width / noise.length;
    let loudCount = 0;
    noise.forEach((value, index) => {
      const isKnown = value > 0 && Number.isFinite(value);
      const isLoud = isKnown && value > LOUD * median;
      loudCount += Number(isLoud);
      const size = isKnown ? Math.max((height * (Math.log10(value) - low)) / (high - low), 1) : height;
      context.globalAlpha = this.picked === null || this.picked === index ? 1 : 0.45;
      context.fillStyle = isLoud ? loud : isKnown ? plain : missing;
      context.fillRect(index * step, height - size, Math.max(step - (step > 3 ? 1 : 0), 0.5), size);
    });
    context.globalAlpha = 1;
    const index = this.picked;
    this.readout.textContent =
      index === null
        ? `median ${brief(median)} ${this.unit}${loudCount ? `, ${loudCount} above ${LOUD} times that` : ""}`
        : `${index + 1} (${this.labels[index] ?? ""}): ${brief(noise[index])} ${this.unit}`;
  }
}
