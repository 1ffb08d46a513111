// Perceptually uniform colour maps from their published control points, and the range that they span. The range
// starts at zero and doesn't follow each frame unless requested, so that a colour means the same value in all frames.

/** viridis and cividis: ten equally spaced points of the maps by van der Walt, Smith and Firing (CC0) and by Nuñez,
 * Anderton and Renslow (2018). signed: RdBu of ColorBrewer
 * (Cynthia Brewer, Apache-2.0), reversed, with zero in the middle. */
const CONTROL_POINTS = {
  viridis: "440154 482878 3e4989 31688e 26828e 1f9e89 35b779 6ece58 b5de2b fde725",
  cividis: "00224e 123570 3b496c 575d6d 707173 8a8678 a59c74 c3b369 e1cc55 fee838",
  signed: "053061 2166ac 4393c3 92c5de d1e5f0 f7f7f7 fddbc7 f4a582 d6604d b2182b 67001f",
};

export type MapName = keyof typeof CONTROL_POINTS;

/** 256 colours as canvas words (alpha, blue, green, red from the highest byte). */
export function table(name: MapName): Uint32Array {
  const points = CONTROL_POINTS[name].split(" ").map((hex) => [0, 2, 4].map((at) => parseInt(hex.slice(at, at + 2), 16)));
  return Uint32Array.from({ length: 256 }, (_, index) => {
    const place = (index / 255) * (points.length - 1);
    const below = Math.min(Math.floor(place), points.length - 2);
    const [red, green, blue] = points[below].map((value, part) => Math.round(value + (place - below) * (points[below + 1][part] - value)));
    return ((255 << 24) | (blue << 16) | (green << 8) | red) >>> 0;
  });
}

export type RangeMode = "hold" | "fixed" | "frame";

export class Range {
  mode: RangeMode = "hold";
  isSymmetric = false;
  fixed: [number, number] = [0, 1];
  private held: [number, number] = [0, 0];
  private hint: [number, number] | null = null;

  begin(hint: [number, number] | null): void {
    this.hint = hint;
    this.reset();
  }

  reset(): void {
    this.held = this.hint ? [...this.hint] : [0, 0];
  }

  /** Updates the range for an image and returns it. */
  update(values: Float32Array): [number, number] {
    let low = Infinity;
    let high = -Infinity;
    for (const value of values) {
      if (value < low) low = value;
      if (value > high) high = value;
    }
    if (low <= high && Number.isFinite(low) && Number.isFinite(high)) {
      this.held = [Math.min(this.held[0], low), Math.max(this.held[1], high)];
    }
    if (this.mode === "fixed") return [...this.fixed];
    const [least, most] = this.mode === "frame" && low <= high ? [low, high] : this.held;
    // Zero means no press: the lowest colour, or the middle one of a two-sided map.
    const size = this.isSymmetric ? Math.max(-least, most) : most;
    const top = size > 0 ? size : (this.hint?.[1] ?? 1);
    return [this.isSymmetric ? -top : 0, top];
  }
}

/** Paints values into pixels; NaN stays transparent. */
export function paint(values: Float32Array, pixels: Uint32Array, colours: Uint32Array, [low, high]: [number, number]): void {
  const scale = high > low ? 255 / (high - low) : 0;
  for (let index = 0; index < values.length; index += 1) {
    const value = values[index];
    if (value !== value) {
      pixels[index] = 0;
    } else {
      const level = (value - low) * scale;
      pixels[index] = colours[level <= 0 ? 0 : level >= 255 ? 255 : (level + 0.5) | 0];
    }
  }
}
