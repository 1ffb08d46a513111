// Damage: drawn over the picture, and listed with its state and healing, together with the baselines it is measured
// against.

import type { DamageView, Scene } from "./protocol";
import { rows, write } from "./rows";
import { element } from "./view";

const find = (id: string) => document.getElementById(id)!;
const duration = (seconds: number) => (seconds < 120 ? `${seconds.toFixed(0)} s` : seconds < 7200 ? `${(seconds / 60).toFixed(0)} min` : `${(seconds / 3600).toFixed(1)} h`);

/** Reasons for proposing a new baseline; the duration follows. */
const REASONS = {
  offset: "the skin at rest differs from its baseline; at rest",
  healed: "damage has healed; at rest",
  touched: "something that touched the skin when the baseline was taken has been gone",
};

export class DamagePanel {
  private readonly layer = element("g", { class: "damages" });

  begin(scene: Scene, overlay: SVGSVGElement): void {
    this.layer.replaceChildren();
    overlay.append(this.layer);
    find("damage-panel").hidden = !scene.watches_damage;
    document.body.classList.toggle("watches-damage", scene.watches_damage);
  }

  show(view: DamageView | null): void {
    if (!view) return;
    this.draw(view);
    const texts = view.list.map((damage): [string, string[]] => {
      const extent = damage.length_mm > 0 ? `${damage.length_mm.toFixed(0)} mm at ${damage.direction_deg.toFixed(0)}°` : "spot";
      const healed = damage.healed > 0.02 ? `${(100 * damage.healed).toFixed(0)} %` : "–";
      return [String(damage.id), [String(damage.id), damage.state, damage.x_mm.toFixed(1), damage.y_mm.toFixed(1), extent, `${(100 * damage.depth).toFixed(0)} %`, healed, duration(damage.for_s)]];
    });
    rows(find("damages"), new Map(texts)).forEach((row, index) => {
      const damage = view.list[index];
      row.dataset.id = String(damage.id);
      row.dataset.state = damage.state;
      row.dataset.xMm = damage.x_mm.toFixed(3);
      row.dataset.yMm = damage.y_mm.toFixed(3);
      row.dataset.lengthMm = damage.length_mm.toFixed(3);
      row.dataset.healed = damage.healed.toFixed(3);
      row.dataset.forS = damage.for_s.toFixed(1);
    });
    write(find("damage-count"), String(view.list.filter(({ state }) => state !== "healed" && state !== "suspected").length));
    const history = view.baselines.map((baseline, index): [string, string[]] => {
      const role = [index === view.intact ? "intact" : "", index === view.baselines.length - 1 ? "in use" : ""].filter(Boolean).join(", ");
      return [String(index), [String(index + 1), baseline.reason || baseline.origin, `${duration(baseline.age_s)} ago`, role]];
    });
    rows(find("baselines"), new Map(history)).forEach((row, index) => {
      row.dataset.origin = view.baselines[index].origin;
      row.dataset.isIntact = String(index === view.intact);
    });
    const { proposal } = view;
    find("proposal").hidden = !proposal;
    if (proposal) {
      find("proposal").dataset.reason = proposal.reason;
      write(find("proposal-text"), `${REASONS[proposal.reason]} for ${duration(proposal.for_s)}, ${proposal.offset_sigma.toFixed(1)} σ off`);
    }
  }

  private draw(view: DamageView): void {
    const marks = view.list.filter(({ state }) => state !== "suspected").map((damage) => {
      const group = element("g", { class: `damage ${damage.state}`, "data-damage": damage.id });
      const [[x0, y0], [x1, y1]] = damage.ends_mm;
      const shape = damage.length_mm > 0 ? element("path", { d: `M${x0} ${-y0}L${x1} ${-y1}` }) : element("circle", { cx: damage.x_mm, cy: -damage.y_mm, r: 2 });
      group.append(shape);
      return group;
    });
    this.layer.replaceChildren(...marks);
  }
}
