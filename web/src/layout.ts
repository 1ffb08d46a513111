// The page's layout: visible panels and their sizes, light or dark theme. The settings are saved.

import { type Settings, type Theme, initialSettings, loadSettings, saveSettings } from "./settings";

/** Fired when the theme changes, so that drawings in the theme's colours are redrawn. */
export const THEME_EVENT = "dermis-theme";

const SIDE = { least: 0.2, most: 0.75, step: 0.02 };
const BOTTOM = { least: 90, most: 500, step: 20 };
const THEMES: Theme[] = ["auto", "light", "dark"];

/** Windows too low for the panels below the picture, unless they are asked for. */
const LOW_WINDOW = matchMedia("(max-height: 850px)");

const find = <T extends HTMLElement>(id: string) => document.getElementById(id) as T;
const clamp = (value: number, { least, most }: { least: number; most: number }) => Math.min(Math.max(value, least), most);

export class Layout {
  private settings: Settings = loadSettings();
  private readonly main = document.querySelector("main")!;
  private readonly boxes = [...document.querySelectorAll<HTMLInputElement>("#panels input[data-panel]")];

  constructor() {
    for (const box of this.boxes) box.addEventListener("change", () => this.put(box.dataset.panel!, !box.checked));
    find("theme").addEventListener("click", () => this.nextTheme());
    find("fold").addEventListener("click", () => this.fold());
    LOW_WINDOW.addEventListener("change", () => this.apply());
    find("layout-reset").addEventListener("click", () => this.reset());
    this.bindSplitter(find("split-side"), "side");
    this.bindSplitter(find("split-bottom"), "bottom");
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => document.dispatchEvent(new Event(THEME_EVENT)));
    document.addEventListener("click", (event) => {
      for (const menu of document.querySelectorAll<HTMLDetailsElement>(".menu[open]")) {
        if (!menu.contains(event.target as Node)) menu.open = false;
      }
    });
    this.apply();
  }

  private put(panel: string, isAway: boolean): void {
    this.settings.away = this.settings.away.filter((one) => one !== panel);
    if (isAway) this.settings.away.push(panel);
    this.changed();
  }

  private get isFolded(): boolean {
    return this.settings.folded ?? LOW_WINDOW.matches;
  }

  private fold(): void {
    this.settings.folded = !this.isFolded;
    this.changed();
  }

  private nextTheme(): void {
    this.settings.theme = THEMES[(THEMES.indexOf(this.settings.theme) + 1) % THEMES.length];
    this.changed();
  }

  private reset(): void {
    this.settings = { ...initialSettings(), theme: this.settings.theme };
    this.changed();
  }

  private changed(): void {
    saveSettings(this.settings);
    this.apply();
  }

  private apply(): void {
    const { away, side, bottom, theme } = this.settings;
    for (const box of this.boxes) {
      const isAway = away.includes(box.dataset.panel!);
      box.checked = !isAway;
      find(box.dataset.panel!).classList.toggle("away", isAway);
    }
    for (const part of ["side", "bottom"]) {
      const isEmpty = !document.querySelector(`.${part} > .panel:not(.away, #damage-panel)`);
      this.main.classList.toggle(`no-${part}`, isEmpty);
    }
    this.main.classList.toggle("folded", this.isFolded);
    find("fold").setAttribute("aria-expanded", String(!this.isFolded));
    this.main.style.setProperty("--side", side === null ? "" : `${(100 * side).toFixed(1)}%`);
    this.main.style.setProperty("--bottom", bottom === null ? "" : `${bottom.toFixed(0)}px`);
    find("split-side").setAttribute("aria-valuenow", String(Math.round(100 * (side ?? 0.4))));
    find("split-bottom").setAttribute("aria-valuenow", String(Math.round(bottom ?? 185)));
    document.documentElement.dataset.theme = theme;
    find("theme").textContent = `Theme: ${theme}`;
    document.dispatchEvent(new Event(THEME_EVENT));
  }

  /** Sizes change by dragging or with the arrow keys; a double click restores the original size. */
  private bindSplitter(handle: HTMLElement, what: "side" | "bottom"): void {
    const limits = what === "side" ? SIDE : BOTTOM;
    const size = (event: PointerEvent) => {
      const box = this.main.getBoundingClientRect();
      return what === "side" ? (box.right - event.clientX) / box.width : box.bottom - event.clientY;
    };
    handle.addEventListener("pointerdown", (event) => {
      event.preventDefault();
      handle.focus();
      handle.setPointerCapture(event.pointerId);
    });
    handle.addEventListener("pointermove", (event) => {
      if (!handle.hasPointerCapture(event.pointerId)) return;
      this.settings[what] = clamp(size(event), limits);
      this.changed();
    });
    handle.addEventListener("dblclick", () => {
      this.settings[what] = null;
      this.changed();
    });
    handle.addEventListener("keydown", (event) => {
      const [more, less] = what === "side" ? ["ArrowLeft", "ArrowRight"] : ["ArrowUp", "ArrowDown"];
      if (event.key !== more && event.key !== less) return;
      event.preventDefault();
      const now = this.settings[what] ?? Number(handle.getAttribute("aria-valuenow")) / (what === "side" ? 100 : 1);
      this.settings[what] = clamp(now + (event.key === more ? limits.step : -limits.step), limits);
      this.changed();
    });
  }
}
