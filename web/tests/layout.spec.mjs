// The page's layout at three window sizes, in light and dark, for skins of several shapes: the skin gets the room, and
// nothing covers its axes. Everything is measured; PAGE_PICTURES keeps the windows as pictures.

import assert from "node:assert/strict";
import { execFile } from "node:child_process";
import { mkdtemp, rm } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { promisify } from "node:util";
import { isDemo, keepPicture, openPage, pressAt, startBrowser, startServer, stopDemonstration, waitForRows } from "./browser.mjs";

const dermis = (...args) => promisify(execFile)(process.env.DERMIS_BIN, args);

/** Smallest shares of the window: of its height by the skin or, for skins wider than this, of its width. On the phone
 * the height is that of the skin with its axes. */
const WINDOWS = [
  { name: "1280x720", width: 1280, height: 720, heightShare: 0.6, widthShare: 0.75, wide: 1.6 },
  { name: "1920x1080", width: 1920, height: 1080, heightShare: 0.55, widthShare: 0.75, wide: 1.6 },
  { name: "phone", width: 390, height: 844, heightShare: 0.45, widthShare: 0.8, wide: 1.05 },
];
/** Skins that `dermis run` is given. */
const SKINS = {
  square: () => [],
  disc: () => ["ionic-disc"],
  wide: async (folder) => {
    await dermis("new", "wide-pad", "--outline", "rectangle:120x40", "--electrodes", "16", "--layer", "gel", "--instrument", "none", "--out", folder);
    return [join(folder, "wide-pad.toml")];
  },
  coils: () => ["skins/examples/em-3x4.toml"],
  calibrated: async (folder) => {
    const [pokes, forces] = [join(folder, "pokes.json"), join(folder, "forces.json")];
    await dermis("calibrate", "ionic-disc", "--twin", "--pokes", "20", "--out", pokes);
    await dermis("calibrate", "ionic-disc", "--twin", "--forces", forces, "--curve", "quadratic");
    return ["ionic-disc", "--calibration", pokes, "--forces", forces];
  },
};

let browser;
let folder;

before(async () => {
  [browser, folder] = await Promise.all([startBrowser(), mkdtemp(join(tmpdir(), "dermis-page-"))]);
});

after(async () => {
  await browser?.close();
  if (folder) await rm(folder, { recursive: true });
});

/** Boxes in the window, and what stands in the page. */
const look = (page) => page.evaluate(() => {
  const box = (element) => {
    const { left, top, right, bottom } = element.getBoundingClientRect();
    return { left, top, right, bottom, text: element.textContent };
  };
  const one = (query) => box(document.querySelector(query));
  const all = (query) => [...document.querySelectorAll(query)].filter((element) => element.checkVisibility()).map(box);
  const { width, height } = document.querySelector("#classes");
  const pixels = document.querySelector("#classes").getContext("2d").getImageData(0, 0, width, height).data;
  const marked = [];
  for (let at = 0; at < width * height; at += 1) if (pixels[4 * at + 3] > 0) marked.push([at % width, Math.floor(at / width)]);
  const span = (axis) => marked.length && Math.max(...marked.map((place) => place[axis])) - Math.min(...marked.map((place) => place[axis])) + 1;
  const table = document.querySelector("#touches-panel .scroll");
  return {
    outline: one(".outline"),
    stage: one("#stage"),
    twin: all("#badges .badge").filter(({ text }) => text === "digital twin"),
    axes: all(".axes text"),
    words: all("#cursor, #stage-help, #demo-state, .legend > *, .electrodes text"),
    touches: all("#touches tr").length,
    sigma: one("#touches tr td:nth-child(4)"),
    force: one("#touches tr td:nth-child(5)"),
    tableCut: table.scrollWidth - table.clientWidth,
    hasNetwork: !document.querySelector("#classes-choice").hidden,
    legend: all("#classes-choice .swatch").length,
    /** Share of the box around what the network marks that its lines cover. */
    covered: marked.length / Math.max(1, span(0) * span(1)),
    amplitudeUnit: document.querySelector("#amplitude-unit").textContent,
    pageWidth: document.documentElement.scrollWidth,
    dot: getComputedStyle(document.querySelector(".dot")).backgroundColor,
    green: getComputedStyle(document.documentElement).getPropertyValue("--good"),
  };
});

const touching = (a, b) => a.left < b.right - 0.5 && b.left < a.right - 0.5 && a.top < b.bottom - 0.5 && b.top < a.bottom - 0.5;

function check(seen, window) {
  const size = ({ left, right, top, bottom }) => ({ width: right - left, height: bottom - top });
  const [skin, stage] = [size(seen.outline), size(seen.stage)];
  const isPhone = window.name === "phone";
  const share = { width: skin.width / window.width, height: (isPhone ? stage : skin).height / window.height };
  console.log(`${window.name}: skin ${skin.width.toFixed(0)} x ${skin.height.toFixed(0)} pixels, ${(100 * share.width).toFixed(0)} % of the width, ${(100 * share.height).toFixed(0)} % of the height`);
  if (skin.width / skin.height > window.wide) assert.ok(share.width >= window.widthShare, `the skin has ${share.width} of the width`);
  else assert.ok(share.height >= window.heightShare, `the skin has ${share.height} of the height`);
  assert.ok(seen.outline.bottom <= window.height, "all of the skin is seen without scrolling");

  assert.equal(seen.twin.length, 1, "it says that this is a twin");
  assert.ok(seen.twin[0].right <= window.width && seen.twin[0].bottom < 80, JSON.stringify(seen.twin));

  assert.ok(seen.axes.length >= 5, `${seen.axes.length} labels at the axes`);
  for (const [index, label] of seen.axes.entries()) {
    assert.ok(label.left >= seen.stage.left - 1 && label.right <= seen.stage.right + 1 && label.bottom <= seen.stage.bottom + 1, `${label.text} is cut off`);
    const over = [...seen.words, ...seen.axes.slice(index + 1)].filter((other) => touching(label, other));
    assert.deepEqual(over.map(({ text }) => text), [], `over ${label.text} at the axis`);
  }

  assert.ok(seen.touches >= 1 && seen.tableCut <= 0, `${seen.touches} touches, ${seen.tableCut} pixels of the table cut off`);
  for (const cell of [seen.sigma, seen.force]) {
    assert.ok(cell.right - cell.left > 10 && cell.left >= 0 && cell.right <= window.width && cell.bottom <= window.height, `${cell.text} is out of sight`);
  }
  assert.ok(seen.pageWidth <= window.width, `${seen.pageWidth} pixels wide`);
}

for (const [name, args] of Object.entries(isDemo ? { demo: () => [] } : SKINS)) {
  test(`the skin has the room, and nothing covers its axes: ${name}`, async () => {
    const server = await startServer(0, await args(folder));
    try {
      for (const window of WINDOWS) {
        for (const colorScheme of ["light", "dark"]) {
          const { width, height } = window;
          const phone = window.name === "phone" ? { hasTouch: true, isMobile: true, deviceScaleFactor: 2 } : {};
          const { page } = await openPage(browser, server.address, { viewport: { width, height }, colorScheme, ...phone });
          await stopDemonstration(page);
          const outline = await page.locator(".outline").evaluate((path) => (({ width, height }) => ({ width, height }))(path.getBBox()));
          await pressAt(page, 0.15 * outline.width, 0.18 * outline.height);
          await waitForRows(page, (rows) => rows.length > 0, 60_000);
          await page.waitForTimeout(800);
          const seen = await look(page);
          await keepPicture(page, `layout-${name}-${window.name}-${colorScheme}`);
          check(seen, window);
          if (seen.hasNetwork) {
            assert.equal(seen.legend, 2, "both of the network's classes are in the legend");
            assert.ok(seen.covered < 0.5, `${seen.covered} of the colours under the touch are covered`);
          }
          if (name === "calibrated") {
            assert.equal(seen.amplitudeUnit, "typical pokes");
            assert.match(seen.force.text, /\d/, "the force is shown");
          }
          await page.mouse.up();
          await page.close();
        }
      }
    } finally {
      await server.stop();
    }
  });
}
