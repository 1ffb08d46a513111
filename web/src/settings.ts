// The user's page settings, saved in this browser: hidden panels, sizes, theme. If the browser saves nothing, or the
// saved text is invalid, the page starts with its defaults.

const KEY = "dermis-page";

export type Theme = "auto" | "light" | "dark";

export interface Settings {
  /** Hidden panels, by the id of their box. */
  away: string[];
  /** Share of the width used by the panels next to the picture. */
  side: number | null;
  /** Height of the panels below, pixels. */
  bottom: number | null;
  theme: Theme;
  /** True if the panels below are folded away; null: depends on the window's height. */
  folded: boolean | null;
}

export function initialSettings(): Settings {
  return { away: [], side: null, bottom: null, theme: "auto", folded: null };
}

export function loadSettings(): Settings {
  const settings = initialSettings();
  try {
    const kept: unknown = JSON.parse(localStorage.getItem(KEY) ?? "{}");
    if (typeof kept !== "object" || kept === null) return settings;
    const { away, side, bottom, theme, folded } = kept as Record<string, unknown>;
    if (Array.isArray(away)) settings.away = away.filter((name) => typeof name === "string");
    if (typeof side === "number" && side > 0 && side < 1) settings.side = side;
    if (typeof bottom === "number" && bottom > 0) settings.bottom = bottom;
    if (typeof folded === "boolean") settings.folded = folded;
    if (theme === "light" || theme === "dark") settings.theme = theme;
  } catch {
    // Nothing was saved, or not by this page.
  }
  return settings;
}

export function saveSettings(settings: Settings): void {
  try {
    localStorage.setItem(KEY, JSON.stringify(settings));
  } catch {
    // Saving failed; the setting holds until the page is closed.
  }
}
