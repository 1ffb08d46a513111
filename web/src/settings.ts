// What people set of the page itself, kept in this browser: hidden panels, sizes, theme. A browser that keeps nothing, or
// keeps nonsense, shows the page as it is at first.

const KEY = "dermis-page";

export type Theme = "auto" | "light" | "dark";

export interface Settings {
  /** Panels put away, by the id of their box. */
  away: string[];
  /** Share of the width that the panels beside the picture have. */
  side: number | null;
  /** Height of the panels below, pixels. */
  bottom: number | null;
  theme: Theme;
}

export function initialSettings(): Settings {
  return { away: [], side: null, bottom: null, theme: "auto" };
}

export function loadSettings(): Settings {
  const settings = initialSettings();
  try {
    const kept: unknown = JSON.parse(localStorage.getItem(KEY) ?? "{}");
    if (typeof kept !== "object" || kept === null) return settings;
    const { away, side, bottom, theme } = kept as Record<string, unknown>;
    if (Array.isArray(away)) settings.away = away.filter((name) => typeof name === "string");
    if (typeof side === "number" && side > 0 && side < 1) settings.side = side;
    if (typeof bottom === "number" && bottom > 0) settings.bottom = bottom;
    if (theme === "light" || theme === "dark") settings.theme = theme;
  } catch {
    // Nothing is kept, or not by this page.
  }
  return settings;
}

export function saveSettings(settings: Settings): void {
  try {
    localStorage.setItem(KEY, JSON.stringify(settings));
  } catch {
    // Not kept; it holds until the page is closed.
  }
}
