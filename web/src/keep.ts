// Saves the view to files: the picture with its drawing and colours as PNG, the image's values and touches as CSV.

import { brief } from "./charts";
import type { Image, Scene, State } from "./protocol";

/** Style properties of SVG elements that come from the style sheet. */
const LOOKS = ["display", "fill", "fill-opacity", "fill-rule", "stroke", "stroke-width", "stroke-opacity", "stroke-dasharray", "stroke-linecap", "stroke-linejoin", "paint-order", "vector-effect", "font-weight", "font-size", "font-family", "text-anchor", "transform"];
const MARGIN = 12;
const LEGEND = 46;

function save(blob: Blob, name: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

function nameOf(scene: Scene, frame: number, ending: string): string {
  return `${scene.skin.replace(/[^\w.-]+/g, "-")}-frame-${frame}.${ending}`;
}

/** The skin's name, marked if its readings are simulated. */
const nameIn = ({ skin, is_twin }: Scene) => (is_twin ? `${skin} (digital twin)` : skin);

/** The drawing over the image, with the style sheet's properties written into it. */
function drawing(overlay: SVGSVGElement, width: number, height: number): Promise<HTMLImageElement> {
  const copy = overlay.cloneNode(true) as SVGSVGElement;
  const originals = overlay.querySelectorAll<SVGElement>("*");
  copy.querySelectorAll<SVGElement>("*").forEach((element, index) => {
    const look = getComputedStyle(originals[index]);
    for (const name of LOOKS) element.style.setProperty(name, look.getPropertyValue(name));
  });
  copy.setAttribute("width", String(width));
  copy.setAttribute("height", String(height));
  const picture = new Image_(width, height);
  picture.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(new XMLSerializer().serializeToString(copy))}`;
  return picture.decode().then(() => picture);
}

/** The browser's image element, since `Image` means the skin's image here. */
const Image_ = globalThis.Image;

/** Saves the picture as shown on the stage, with its colour bar. */
export async function savePicture(scene: Scene, frame: number, stage: HTMLElement, overlay: SVGSVGElement, bar: HTMLCanvasElement, range: [number, number], unit: string): Promise<void> {
  const ratio = Math.max(devicePixelRatio, 2);
  const box = stage.getBoundingClientRect();
  const canvas = document.createElement("canvas");
  canvas.width = Math.round(ratio * (box.width + 2 * MARGIN));
  canvas.height = Math.round(ratio * (box.height + 2 * MARGIN + LEGEND));
  const context = canvas.getContext("2d")!;
  const style = getComputedStyle(document.documentElement);
  const colour = (name: string) => style.getPropertyValue(name).trim();
  context.scale(ratio, ratio);
  context.fillStyle = colour("--panel");
  context.fillRect(0, 0, canvas.width, canvas.height);
  context.imageSmoothingEnabled = !stage.classList.contains("no-smooth");
  for (const layer of stage.querySelectorAll("canvas")) {
    const place = layer.getBoundingClientRect();
    const look = getComputedStyle(layer);
    if (look.display === "none" || look.visibility === "hidden" || layer.hidden) continue;
    context.save();
    context.translate(MARGIN + place.left - box.left, MARGIN + place.top - box.top);
    const outline = /"(.*)"/.exec(layer.style.clipPath)?.[1];
    if (outline) context.clip(new Path2D(outline), "evenodd");
    context.drawImage(layer, 0, 0, place.width, place.height);
    context.restore();
  }
  if (getComputedStyle(overlay).visibility !== "hidden") context.drawImage(await drawing(overlay, box.width, box.height), MARGIN, MARGIN, box.width, box.height);
  const top = box.height + 2 * MARGIN;
  context.imageSmoothingEnabled = true;
  context.drawImage(bar, MARGIN, top, box.width, 10);
  context.fillStyle = colour("--ink");
  context.font = "12px system-ui, sans-serif";
  context.fillText(brief(range[0]), MARGIN, top + 26);
  context.textAlign = "right";
  context.fillText(brief(range[1]), MARGIN + box.width, top + 26);
  context.textAlign = "center";
  context.fillText(`${unit}; ${nameIn(scene)}, frame ${frame}`, MARGIN + box.width / 2, top + 26);
  const blob = await new Promise<Blob | null>((resolve) => canvas.toBlob(resolve, "image/png"));
  if (blob) save(blob, nameOf(scene, frame, "png"));
}

/** Saves one row for each pixel of the skin, preceded by comments with the view's description and the touches. */
export function saveTable(scene: Scene, image: Image, state: State | null): void {
  const { x_min_mm, x_max_mm, y_min_mm, y_max_mm } = scene.grid;
  const quantity = [scene.image_quantity, scene.image_unit && `in ${scene.image_unit}`].filter(Boolean).join(" ");
  const lines = [`# skin ${nameIn(scene)}, frame ${image.frame}; value: ${quantity}, at the pixel's middle`];
  for (const touch of state?.touches ?? []) {
    if (touch.phase !== "end") lines.push(`# touch ${touch.id}: x ${touch.x_mm} mm, y ${touch.y_mm} mm, amplitude ${touch.amplitude}`);
  }
  lines.push("x_mm,y_mm,value");
  image.values.forEach((value, index) => {
    if (!Number.isFinite(value)) return;
    const [row, column] = [Math.floor(index / image.cols), index % image.cols];
    const x_mm = x_min_mm + ((column + 0.5) * (x_max_mm - x_min_mm)) / image.cols;
    const y_mm = y_max_mm - ((row + 0.5) * (y_max_mm - y_min_mm)) / image.rows;
    lines.push(`${x_mm.toFixed(4)},${y_mm.toFixed(4)},${value}`);
  });
  save(new Blob([`${lines.join("\n")}\n`], { type: "text/csv" }), nameOf(scene, image.frame, "csv"));
}
