// A network's result for the frame, drawn over the image: pixels of raised (compressed) and lowered (damaged)
// conductivity, each class in its colour, with the probability as opacity.

import type { Classes } from "./protocol";

/** Canvas words with blue, green, red from the highest byte; alpha comes from the probability. */
const COMPRESSED = 0xf0e600;
const DAMAGED = 0x7a3bff;
/** Lower probabilities are not drawn. */
const LEAST = 0.1;

export class ClassOverlay {
  private readonly context: CanvasRenderingContext2D;
  private pixels: ImageData | null = null;
  private shown: Classes | null = null;

  constructor(readonly canvas: HTMLCanvasElement) {
    this.context = canvas.getContext("2d")!;
  }

  draw(classes: Classes | null): void {
    this.shown = classes;
    if (!classes) {
      this.context.clearRect(0, 0, this.canvas.width, this.canvas.height);
      return;
    }
    const { rows, cols, lowered, raised } = classes;
    if (this.pixels?.width !== cols || this.pixels.height !== rows) {
      [this.canvas.width, this.canvas.height] = [cols, rows];
      this.pixels = this.context.createImageData(cols, rows);
    }
    const words = new Uint32Array(this.pixels.data.buffer);
    for (let index = 0; index < words.length; index += 1) {
      const isDamaged = lowered[index] > raised[index];
      const probability = isDamaged ? lowered[index] : raised[index];
      const alpha = probability > LEAST ? Math.round(200 * Math.min(probability, 1)) : 0;
      words[index] = ((alpha << 24) | (isDamaged ? DAMAGED : COMPRESSED)) >>> 0;
    }
    this.context.putImageData(this.pixels, 0, 0);
  }

  /** Probabilities at a place, given as shares of width and height from the top left, as text; empty if unknown. */
  describe(across: number, down: number): string {
    if (!this.shown || across < 0 || across >= 1 || down < 0 || down >= 1) return "";
    const { rows, cols, lowered, raised } = this.shown;
    const index = Math.floor(down * rows) * cols + Math.floor(across * cols);
    const percent = (value: number) => `${(100 * value).toFixed(0)} %`;
    return `compressed ${percent(raised[index])}, damaged ${percent(lowered[index])}`;
  }
}
