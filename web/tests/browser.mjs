// Shared by the browser tests: a server (the demo, or the real command named by DERMIS_BIN) and a browser.

import { spawn } from "node:child_process";
import { existsSync } from "node:fs";
import { mkdir, readFile } from "node:fs/promises";
import { createServer } from "node:http";
import { dirname, extname, join, normalize } from "node:path";
import { createInterface } from "node:readline";
import { fileURLToPath } from "node:url";
import { chromium } from "playwright-core";

const root = join(dirname(fileURLToPath(import.meta.url)), "../..");
const START_LIMIT_MS = 120_000;

/** The demo has none of the real command's options. */
export const isDemo = !process.env.DERMIS_BIN && !process.env.BOOK;

function commandLine(port, extra) {
  const { DERMIS_BIN, DERMIS_ARGS, PAGE_DEMO_BIN } = process.env;
  if (DERMIS_BIN) return [DERMIS_BIN, ["run", "--no-open", "--port", port, ...(DERMIS_ARGS ?? "").split(" ").filter(Boolean), ...extra]];
  if (PAGE_DEMO_BIN) return [PAGE_DEMO_BIN, ["--port", port, ...extra]];
  return ["cargo", ["run", "--quiet", "-p", "dermis-cli", "--example", "page_demo", "--", "--port", port, ...extra]];
}

/** Starts the server, on any free port by default, and waits until it prints `page: ADDRESS`. */
export async function startServer(port = 0, extra = []) {
  return start(commandLine(String(port), extra));
}

/** Starts `dermis run` with a body file. */
export async function startBodyServer(file, extra = []) {
  return start([process.env.DERMIS_BIN, ["run", file, "--no-open", "--port", "0", ...extra]]);
}

async function start([program, args]) {
  const server = spawn(program, args, { cwd: root, stdio: ["ignore", "pipe", "pipe"] });
  const said = [];
  const address = await new Promise((resolve, reject) => {
    const timer = setTimeout(() => reject(new Error(`no address within ${START_LIMIT_MS} ms:\n${said.join("\n")}`)), START_LIMIT_MS);
    const read = (line) => {
      said.push(line);
      const match = /page: (http:\/\/\S+)/.exec(line);
      if (!match) return;
      clearTimeout(timer);
      resolve(match[1]);
    };
    for (const stream of [server.stdout, server.stderr]) createInterface({ input: stream }).on("line", read);
    server.on("error", reject);
    server.on("exit", (code) => reject(new Error(`${program} ended with ${code} before it served:\n${said.join("\n")}`)));
  }).catch((error) => {
    server.kill();
    throw error;
  });
  const ended = new Promise((resolve) => server.once("exit", resolve));
  const stop = () => {
    server.kill("SIGTERM");
    return ended;
  };
  return { address, stop, said };
}

const KINDS = { ".html": "text/html; charset=utf-8", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml", ".png": "image/png", ".wasm": "application/wasm", ".woff2": "font/woff2" };

/** Serves a folder of files; `hidden` names a folder in it to leave out. */
export async function serveFiles(folder, hidden) {
  const serving = createServer(async (request, response) => {
    const path = normalize(decodeURIComponent(new URL(request.url, "http://files").pathname)).replace(/\/$/, "/index.html");
    const bytes = hidden && path.startsWith(hidden) ? null : await readFile(join(folder, path)).catch(() => null);
    response.writeHead(bytes ? 200 : 404, { "Content-Type": KINDS[extname(path)] ?? "application/octet-stream" });
    response.end(request.method === "HEAD" ? undefined : bytes);
  });
  await new Promise((resolve) => serving.listen(0, "127.0.0.1", resolve));
  const stop = () => new Promise((resolve) => (serving.closeAllConnections(), serving.close(resolve)));
  return { address: `http://127.0.0.1:${serving.address().port}`, stop };
}

/** The page to test: a server's or, with BOOK, the self-contained one. */
export async function startPage() {
  if (!process.env.BOOK) return startServer();
  const files = await serveFiles(process.env.BOOK);
  return { ...files, address: `${files.address}/poke/index.html` };
}

/** `draws3d`: WebGL, drawn by the processor if there is no graphics card. */
export async function startBrowser({ draws3d = false } = {}) {
  const candidates = [process.env.CHROMIUM, "/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"];
  const executablePath = candidates.find((path) => path && existsSync(path));
  if (!executablePath) throw new Error("no Chromium found; install the package chromium or set CHROMIUM to its path");
  // Containers run as root, where Chromium's own sandbox cannot start.
  return chromium.launch({ executablePath, args: ["--no-sandbox", "--disable-dev-shm-usage", ...(draws3d ? ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"] : [])] });
}

/** Opens the page and records its requests and complaints. */
export async function openPage(browser, address, options = {}) {
  const page = await browser.newPage({ viewport: { width: 1440, height: 900 }, ...options });
  const requests = [];
  const complaints = [];
  page.on("request", (request) => requests.push(request.url()));
  page.on("websocket", (socket) => requests.push(socket.url()));
  // Warnings about reading pictures back are caused by the tests themselves.
  const isOwn = (text) => text.includes("readback operations using getImageData");
  page.on("console", (message) => ["error", "warning"].includes(message.type()) && !isOwn(message.text()) && complaints.push(message.text()));
  page.on("pageerror", (error) => complaints.push(String(error)));
  await page.goto(address);
  await page.waitForSelector("[data-connection='live']");
  await page.waitForSelector("#wait", { state: "hidden" });
  // Wait for the baseline, or a press would become part of it.
  await page.waitForFunction(() => document.querySelector("#tare-state").textContent.startsWith("baseline"));
  return { page, requests, complaints };
}

/** The point in the window for a point on the skin. */
export async function windowFromSkin(page, x_mm, y_mm) {
  return page.locator("#overlay").evaluate((svg, [x, y]) => {
    const point = new DOMPoint(x, -y).matrixTransform(svg.getScreenCTM());
    return { x: point.x, y: point.y };
  }, [x_mm, y_mm]);
}

/** Opens a menu of the page, such as `view-menu`, or closes it. */
export async function unfold(page, id, isOpen = true) {
  const menu = page.locator(`#${id}`);
  if ((await menu.evaluate(({ open }) => open)) !== isOpen) await menu.locator("summary").click();
}

/** Touches as listed in the table. */
export async function touchRows(page) {
  return page.locator("#touches tr").evaluateAll((rows) => rows.map(({ dataset }) => ({ id: dataset.id, x_mm: Number(dataset.xMm), y_mm: Number(dataset.yMm) })));
}

/** Number of frames that the pipeline has processed. */
export async function processedFrames(page) {
  return Number(await page.locator("[data-counter='frames'] td").nth(1).textContent());
}

/** Waits until the result of `read` meets the condition, and returns it. Fails with the last result after the time
 * limit and, if given, not before this many processed frames: on a slow machine frames may queue for long. */
export async function waitUntil(page, what, read, isWanted, { ms = 30_000, frames = 0 } = {}) {
  const until = Date.now() + ms;
  const first = frames > 0 ? await processedFrames(page) : 0;
  let seen;
  for (;;) {
    seen = await read();
    if (isWanted(seen)) return seen;
    if (Date.now() >= until && (frames === 0 || (await processedFrames(page)) - first >= frames)) break;
    await page.waitForTimeout(30);
  }
  const told = await page.locator("#messages li").allTextContents();
  throw new Error(`${what}: not seen within ${ms} ms and ${frames} frames; there was ${JSON.stringify(seen)}; messages: ${JSON.stringify(told)}`);
}

/** Waits until the rows of touches meet the condition; on failure shows the last rows. */
export async function waitForRows(page, isWanted, ms = 8000, frames = 0) {
  return waitUntil(page, "touches", () => touchRows(page), isWanted, { ms, frames });
}

/** Makes sure that only the page presses: stops the twin's demonstration and waits for its end. */
export async function stopDemonstration(page) {
  if (isDemo) return;
  const demo = page.locator("#demo");
  // Not a click of the mouse, because a narrow window folds the button away.
  if ((await demo.getAttribute("aria-pressed")) === "true") await demo.evaluate((button) => button.click());
  await waitForRows(page, (rows) => rows.length === 0, 60_000);
}

/** Puts the mouse down at a place on the skin, millimetres. */
export async function pressAt(page, x_mm, y_mm) {
  const { x, y } = await windowFromSkin(page, x_mm, y_mm);
  await page.mouse.move(x, y);
  await page.mouse.down();
}

/** Saves a picture of the window if PAGE_PICTURES names a folder. */
export async function keepPicture(page, name) {
  const folder = process.env.PAGE_PICTURES;
  if (!folder) return;
  await mkdir(folder, { recursive: true });
  await page.screenshot({ path: join(folder, `${name}.png`) });
}

/** Damage as shown in the list. */
export async function damageRows(page) {
  return page.locator("#damages tr").evaluateAll((rows) => rows.map(({ dataset }) => ({
    id: dataset.id, state: dataset.state, x_mm: Number(dataset.xMm), y_mm: Number(dataset.yMm), length_mm: Number(dataset.lengthMm), healed: Number(dataset.healed), for_s: Number(dataset.forS),
  })));
}

/** Baselines as shown in the history, oldest first. */
export async function baselineRows(page) {
  return page.locator("#baselines tr").evaluateAll((rows) => rows.map((row) => ({ origin: row.dataset.origin, reason: row.cells[1].textContent, isIntact: row.dataset.isIntact === "true" })));
}

/** Pixels of the class overlay in the colour of compressed or damaged: their amount (the sum of opacities, 0 to
 * 1 each) and their centroid on the skin. */
export async function classesSeen(page) {
  return page.locator("#classes").evaluate((canvas) => {
    const { width, height } = canvas;
    const { data } = canvas.getContext("2d").getImageData(0, 0, width, height);
    const box = canvas.getBoundingClientRect();
    const skinFromScreen = document.querySelector("#overlay").getScreenCTM().inverse();
    const sums = { compressed: [0, 0, 0], damaged: [0, 0, 0] };
    for (let index = 0; index < width * height; index += 1) {
      const [red, , blue, alpha] = data.subarray(4 * index, 4 * index + 4);
      if (alpha === 0) continue;
      const [column, row] = [index % width, Math.floor(index / width)];
      const place = new DOMPoint(box.left + ((column + 0.5) * box.width) / width, box.top + ((row + 0.5) * box.height) / height).matrixTransform(skinFromScreen);
      const sum = sums[red > blue ? "damaged" : "compressed"];
      [alpha / 255, (alpha / 255) * place.x, (alpha / 255) * -place.y].forEach((value, at) => (sum[at] += value));
    }
    const seen = ([weight, x, y]) => ({ weight, x_mm: x / weight, y_mm: y / weight });
    return { isShown: getComputedStyle(canvas).display !== "none", compressed: seen(sums.compressed), damaged: seen(sums.damaged) };
  });
}
