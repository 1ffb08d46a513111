// Explanations of the page's terms, shown under the mouse. Those for the markup itself are in index.html.

const STAGES: Record<string, string> = {
  queue: "From the frame's first byte to the start of processing",
  condition: "Channels put in order, baseline subtracted, health checked",
  image: "From the change of the channels to the image",
  touches: "From the image to touches",
  total: "From the frame's first byte to its touches",
};

const COUNTERS: Record<string, string> = {
  frames: "Frames that were processed",
  dropped: "Frames dropped here because the pipeline was too slow",
  lost: "Frames lost on the way, judging by their sequence numbers",
  damaged: "Frames damaged on the way: wrong checksum",
  "not recorded": "Frames that could not be written to the recording",
  repeated: "Copies of the previous frame, skipped; no data is lost",
};

const BADGES: [RegExp, string][] = [
  [/^EIT$/, "Electrical impedance tomography: currents through some electrodes, voltages at others"],
  [/^MIT$/, "Magnetic induction tomography: coils that induce eddy currents and sense them"],
  [/^digital twin$/, "Readings are simulated from the physics of this skin"],
  [/^measured$/, "Readings come from an instrument or a recording"],
  [/electrodes$/, "Electrodes, or coils, numbered from 1"],
  [/channels$/, "Readings per frame, each from a driving and a measuring pair"],
  [/ × /, "Pixels of the image, columns by rows"],
];

/** Explanation of a pipeline stage or a counter; empty for other names. */
export function wordFor(name: string): string {
  return STAGES[name] ?? COUNTERS[name] ?? "";
}

export function wordForBadge(text: string): string {
  return BADGES.find(([pattern]) => pattern.test(text))?.[1] ?? "";
}
