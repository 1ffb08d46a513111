// Traces of the last seconds: touch amplitudes, and the selected channels.

import uPlot from "uplot";
import type { Channels, Touch } from "./protocol";
import { THEME_EVENT } from "./layout";
import { TOUCH_COLOURS } from "./view";

const WINDOW_S = 20;
/** Limit at 100 updates per second. */
const MOST_POINTS = 2000;
const CHANNEL_COLOURS = ["#56b4e9", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#0072b2", "#f0e442", "#999999"];
export const MOST_TRACES = CHANNEL_COLOURS.length;

const css = (name: string) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** A plot of a few series against seconds; redrawn only on request. */
class Strip {
  private plot: uPlot | null = null;
  private times: number[] = [];
  private series: (number | null)[][] = [];
  private names: string[] = [];

  constructor(
    private readonly host: HTMLElement,
    private readonly colours: string[],
  ) {
    new ResizeObserver(() => this.resize()).observe(host);
    document.addEventListener(THEME_EVENT, () => this.build());
  }

  begin(names: string[]): void {
    this.names = names;
    this.times = [];
    this.series = names.map(() => []);
    this.build();
  }

  push(time_s: number, values: (number | null)[]): void {
    const last = this.times.length - 1;
    // The time goes backwards when a replay restarts.
    if (last >= 0 && time_s < this.times[last]) this.begin(this.names);
    this.times.push(time_s);
    this.series.forEach((one, index) => one.push(values[index] ?? null));
    let stale = Math.max(this.times.length - MOST_POINTS, 0);
    while (this.times[stale] < time_s - WINDOW_S) stale += 1;
    // Drop old points in chunks: shifting the arrays for every point would cost more than drawing them.
    if (stale < MOST_POINTS / 10) return;
    this.times.splice(0, stale);
    for (const one of this.series) one.splice(0, stale);
  }

  draw(): void {
    const end = this.times[this.times.length - 1];
    if (!this.plot || end === undefined) return;
    // Use seconds before now, so that the grid stands still and the traces move.
    const ago = this.times.map((time) => time - end);
    this.plot.setData([ago, ...this.series] as uPlot.AlignedData, true);
  }

  private build(): void {
    this.plot?.destroy();
    const axis: uPlot.Axis = { stroke: css("--muted"), grid: { stroke: css("--line"), width: 1 }, ticks: { stroke: css("--line"), width: 1 }, font: "11px system-ui, sans-serif" };
    const options: uPlot.Options = {
      ...this.size(),
      cursor: { show: false },
      legend: { show: false },
      padding: [8, 16, 0, 0],
      scales: { x: { time: false, range: () => [-WINDOW_S, 0] }, y: { range: (_, low, high) => spread(low, high) } },
      axes: [
        { ...axis, size: 30, gap: 4, values: (_, splits) => splits.map((split) => (split === 0 ? "now" : `${split} s`)) },
        { ...axis, size: 58, values: (_, splits) => splits.map((split) => brief(split)) },
      ],
      series: [{}, ...this.names.map((label, index) => ({ label, stroke: this.colours[index % this.colours.length], width: 1.5, points: { show: false }, spanGaps: false }))],
    };
    this.plot = new uPlot(options, [this.times, ...this.series] as uPlot.AlignedData, this.host);
    this.draw();
  }

  private size(): { width: number; height: number } {
    return { width: Math.max(this.host.clientWidth, 50), height: Math.max(this.host.clientHeight, 40) };
  }

  private resize(): void {
    this.plot?.setSize(this.size());
  }
}

/** Adds a little room above and below, even around a constant. */
function spread(low: number | null, high: number | null): [number, number] {
  if (low === null || high === null || !Number.isFinite(low) || !Number.isFinite(high)) return [0, 1];
  const room = high > low ? 0.06 * (high - low) : Math.abs(high) * 0.05 || 1;
  return [low - room, high + room];
}

/** A number in few characters. */
export function brief(value: number | null): string {
  if (value === null || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size === 0) return "0";
  return size >= 1e5 || size < 1e-3 ? value.toExponential(1).replace("e+", "e") : String(Number(value.toPrecision(3)));
}

/** Amplitudes of touches, one line per colour; touches whose numbers share a colour share a line. */
export class AmplitudeStrip {
  private readonly strip: Strip;

  constructor(host: HTMLElement) {
    this.strip = new Strip(host, TOUCH_COLOURS);
    this.begin();
  }

  begin(): void {
    this.strip.begin(TOUCH_COLOURS.map((_, index) => `touch ${index}`));
  }

  push(time_s: number, touches: Touch[]): void {
    const values: (number | null)[] = TOUCH_COLOURS.map(() => null);
    for (const touch of touches) if (touch.phase !== "end") values[touch.id % TOUCH_COLOURS.length] = touch.amplitude;
    this.strip.push(time_s, values);
  }

  draw(): void {
    this.strip.draw();
  }
}

/** Values of the selected channels. */
export class ChannelStrip {
  private readonly strip: Strip;
  private chosen: number[] = [];

  constructor(host: HTMLElement) {
    this.strip = new Strip(host, CHANNEL_COLOURS);
  }

  /** Shows these channels (0-based), at most `MOST_TRACES` of them. */
  choose(channels: number[], labels: string[]): void {
    this.chosen = channels.slice(0, MOST_TRACES);
    this.strip.begin(this.chosen.map((channel) => `${channel + 1} (${labels[channel] ?? ""})`));
  }

  push(time_s: number, { indices, values }: Channels): void {
    this.strip.push(
      time_s,
      this.chosen.map((channel) => {
        const value = indices.length ? values[indices.indexOf(channel)] : values[channel];
        return Number.isFinite(value) ? value : null;
      }),
    );
  }

  draw(): void {
    this.strip.draw();
  }
}

/** Converts channel numbers from 1, written as `1, 5, 20-24`, to indices from 0. Null if the text is invalid. */
export function parseChannels(text: string, count: number): number[] | null {
  const chosen = new Set<number>();
  for (const part of text.split(/[\s,;]+/).filter(Boolean)) {
    const match = /^(\d+)(?:[-–](\d+))?$/.exec(part);
    if (!match) return null;
    const first = Number(match[1]);
    const last = Number(match[2] ?? first);
    if (first < 1 || last < first || last > count) return null;
    for (let number = first; number <= last && chosen.size <= count; number += 1) chosen.add(number - 1);
  }
  return [...chosen];
}
