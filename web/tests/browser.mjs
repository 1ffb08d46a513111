// What the browser tests share: a server to look at (the demo, or the real command named by DERMIS_BIN) and a browser.

import { spawn } from "node:child_process";
import { existsSync } from "node:fs";
import { dirname, join } from "node:path";
import { createInterface } from "node:readline";
import { fileURLToPath } from "node:url";
import { chromium } from "playwright-core";

const root = join(dirname(fileURLToPath(import.meta.url)), "../..");
const START_LIMIT_MS = 120_000;

/** Against the demo there are no options of the real command to try. */
export const isDemo = !process.env.DERMIS_BIN;

function commandLine(port, extra) {
  const { DERMIS_BIN, DERMIS_ARGS, PAGE_DEMO_BIN } = process.env;
  if (DERMIS_BIN) return [DERMIS_BIN, ["run", "--no-open", "--port", port, ...(DERMIS_ARGS ?? "").split(" ").filter(Boolean), ...extra]];
  if (PAGE_DEMO_BIN) return [PAGE_DEMO_BIN, ["--port", port, ...extra]];
  return ["cargo", ["run", "--quiet", "-p", "dermis-cli", "--example", "page_demo", "--", "--port", port, ...extra]];
}

/** Starts the server, on any free port unless told otherwise, and waits until it prints `page: ADDRESS`. */
export async function startServer(port = 0, extra = []) {
  const [program, args] = commandLine(String(port), extra);
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
  return { address, stop };
}

export async function startBrowser() {
  const candidates = [process.env.CHROMIUM, "/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"];
  const executablePath = candidates.find((path) => path && existsSync(path));
  if (!executablePath) throw new Error("no Chromium found; install the package chromium or set CHROMIUM to its path");
  // Containers run as root, where Chromium's own sandbox cannot start.
  return chromium.launch({ executablePath, args: ["--no-sandbox", "--disable-dev-shm-usage"] });
}

/** Opens the page, keeping what it loads and complains about. */
export async function openPage(browser, address, options = {}) {
  const page = await browser.newPage({ viewport: { width: 1440, height: 900 }, ...options });
  const requests = [];
  const complaints = [];
  page.on("request", (request) => requests.push(request.url()));
  page.on("websocket", (socket) => requests.push(socket.url()));
  page.on("console", (message) => ["error", "warning"].includes(message.type()) && complaints.push(message.text()));
  page.on("pageerror", (error) => complaints.push(String(error)));
  await page.goto(address);
  await page.waitForSelector("[data-connection='live']");
  await page.waitForSelector("#wait", { state: "hidden" });
  // Before the baseline is there, a press would become part of it.
  await page.waitForFunction(() => document.querySelector("#tare-state").textContent.startsWith("baseline"));
  return { page, requests, complaints };
}

/** The point of the window over a point of the skin. */
export async function windowFromSkin(page, x_mm, y_mm) {
  return page.locator("#overlay").evaluate((svg, [x, y]) => {
    const point = new DOMPoint(x, -y).matrixTransform(svg.getScreenCTM());
    return { x: point.x, y: point.y };
  }, [x_mm, y_mm]);
}

/** Touches as the table shows them. */
export async function touchRows(page) {
  return page.locator("#touches tr").evaluateAll((rows) => rows.map(({ dataset }) => ({ id: dataset.id, x_mm: Number(dataset.xMm), y_mm: Number(dataset.yMm) })));
}

/** Waits until a row satisfies `isWanted`; fails with what there was. */
export async function waitForRows(page, isWanted, limit_ms = 8000) {
  const until = Date.now() + limit_ms;
  let rows = [];
  while (Date.now() < until) {
    rows = await touchRows(page);
    if (isWanted(rows)) return rows;
    await page.waitForTimeout(30);
  }
  throw new Error(`not seen within ${limit_ms} ms; touches: ${JSON.stringify(rows)}`);
}
