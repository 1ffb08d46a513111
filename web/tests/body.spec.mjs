// The page of a body: the robot in space with its skins, presses in space, states and verdicts, sliders that move joints,
// and the patches' own pages. Only `dermis run` has it, so these tests need DERMIS_BIN.

import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { mkdtemp, readFile, rm, writeFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { keepPicture, startBodyServer, startBrowser } from "./browser.mjs";

const axe = createRequire(import.meta.url).resolve("axe-core/axe.min.js");
/** Skips every test without the real command. */
const skip = process.env.DERMIS_BIN ? false : "needs DERMIS_BIN";
/** Largest distance of a touch from where the ray met the skin, beyond three of its standard deviations. */
const REACH_MM = 5;
const WINDOWS = [{ name: "small", width: 1280, height: 720 }, { name: "large", width: 1920, height: 1080 }, { name: "phone", width: 390, height: 844 }];

/** An arm that stands still until the page moves it. */
const STILL = `name = "still-arm"
urdf = "arm.urdf"

[joints]
at = { elbow = 0.6, shoulder_pitch = 0.2 }

[[patch]]
name = "palm"
skin = "ionic-disc"
link = "palm"
xyz_mm = [90, 0, 15]

[[patch]]
name = "chest"
skin = "healing-square"
link = "torso"
xyz_mm = [100, 0, 300]
rpy_deg = [90, 0, 90]
guard = { any_touch = true, stale_after_ms = 1000 }

[[patch]]
name = "back"
skin = "em-8"
source = "nowhere.csv"
link = "torso"
xyz_mm = [-100, 0, 300]
rpy_deg = [90, 0, -90]
`;

let folder;
let browser;

before(async () => {
  if (skip) return;
  folder = await mkdtemp(join(tmpdir(), "dermis-body-"));
  const made = spawnSync(process.env.DERMIS_BIN, ["body", "demo", join(folder, "arm")]);
  assert.equal(made.status, 0, String(made.stderr));
  await writeFile(join(folder, "arm", "still.toml"), STILL);
  browser = await startBrowser({ draws3d: true });
}, { timeout: 120_000 });

after(async () => {
  await browser?.close();
  if (folder) await rm(folder, { recursive: true });
});

/** Serves a body and opens its page; both end with the test. */
async function open(t, file, extra = [], options = {}) {
  const server = await startBodyServer(join(folder, "arm", file), extra);
  const page = await browser.newPage({ viewport: { width: 1280, height: 720 }, ...options });
  t.after(async () => {
    await page.close();
    await server.stop();
  });
  const [complaints, requests] = [[], []];
  // Drawing by the processor is slow, and the browser says so.
  page.on("console", (message) => ["error", "warning"].includes(message.type()) && !/GPU stall|GL Driver Message|swiftshader/i.test(message.text()) && complaints.push(message.text()));
  page.on("pageerror", (error) => complaints.push(String(error)));
  page.on("request", (request) => requests.push(request.url()));
  page.on("websocket", (socket) => requests.push(socket.url()));
  await page.goto(server.address);
  await page.waitForSelector("#wait", { state: "hidden", timeout: 60_000 });
  return { server, page, complaints, requests };
}

const touches = (page) => page.locator("#touches tr").evaluateAll((rows) => rows.map(({ dataset }) => ({
  patch: dataset.patch, frame: dataset.frame, position_mm: dataset.positionMm.split(" ").map(Number), sigma_mm: dataset.sigmaMm.split(" ").map(Number), force_n: dataset.forceN === "" ? null : Number(dataset.forceN),
})));
const place = (page, patch, x_mm, y_mm) => page.evaluate((of) => window.dermisBody.place(...of), [patch, x_mm, y_mm]);
const state = (page) => page.evaluate(() => window.dermisBody.state());
const distance = (a, b) => Math.hypot(...a.map((value, axis) => value - b[axis]));
const chip = (page, patch, cell) => page.locator(`#patches tr[data-patch="${patch}"] td:nth-child(${cell})`).textContent();

async function until(page, what, read, isWanted, ms = 40_000) {
  const end = Date.now() + ms;
  let seen;
  do {
    seen = await read();
    if (isWanted(seen)) return seen;
    await page.waitForTimeout(50);
  } while (Date.now() < end);
  assert.fail(`${what}: not seen within ${ms} ms; there was ${JSON.stringify(seen)}`);
}

/** Stops the demonstration, and waits until its touches have gone. */
async function quiet(page, patches) {
  await until(page, "running patches", () => Promise.all(patches.map((patch) => chip(page, patch, 2))), (states) => states.every((one) => one === "running"), 90_000);
  if ((await page.locator("#demo").textContent()).startsWith("Stop")) await page.locator("#demo").click();
  await until(page, "no touch", () => touches(page), (rows) => rows.length === 0);
}

/** Presses a skin in space; the touch must show where the ray met it. */
async function pressed(page, patch, x_mm, y_mm) {
  const at = await place(page, patch, x_mm, y_mm);
  assert.equal(at.meets?.patch, patch, `nothing hides the place: ${JSON.stringify(at)}`);
  await page.mouse.move(at.window.x, at.window.y);
  await page.mouse.down();
  const rows = await until(page, `a touch on ${patch}`, () => touches(page), (now) => now.some((row) => row.patch === patch));
  // The first frames of a touch may be off.
  await page.waitForTimeout(500);
  const touch = (await touches(page)).find((row) => row.patch === patch) ?? rows.find((row) => row.patch === patch);
  const off = distance(touch.position_mm, at.root_mm);
  console.log(`${patch}: the ray met ${at.root_mm.map((mm) => mm.toFixed(1))} mm in the root's frame; the touch is ${off.toFixed(2)} mm off, force ${touch.force_n}`);
  assert.equal(touch.frame, "root");
  assert.ok(off <= REACH_MM + 3 * Math.hypot(...touch.sigma_mm), `${touch.position_mm} is ${off} mm from ${at.root_mm}`);
  return touch;
}

/** One triangle in every format of meshes, by file name. */
function meshFiles() {
  const [corners, indices] = [new Float32Array([0, 0, 0, 0.1, 0, 0, 0, 0.1, 0]), new Uint16Array([0, 1, 2])];
  const buffer = Buffer.concat([Buffer.from(corners.buffer), Buffer.from(indices.buffer), Buffer.alloc(2)]);
  const gltf = (buffers) => JSON.stringify({
    asset: { version: "2.0" }, buffers, scene: 0, scenes: [{ nodes: [0] }], nodes: [{ mesh: 0 }],
    meshes: [{ primitives: [{ attributes: { POSITION: 0 }, indices: 1 }] }],
    bufferViews: [{ buffer: 0, byteLength: 36 }, { buffer: 0, byteOffset: 36, byteLength: 6 }],
    accessors: [{ bufferView: 0, componentType: 5126, count: 3, type: "VEC3" }, { bufferView: 1, componentType: 5123, count: 3, type: "SCALAR" }],
  });
  const word = (value) => Buffer.from(new Uint32Array([value]).buffer);
  const plain = gltf([{ byteLength: buffer.length }]);
  const json = Buffer.from(plain.padEnd(Math.ceil(plain.length / 4) * 4));
  const chunks = Buffer.concat([word(json.length), Buffer.from("JSON"), json, word(buffer.length), Buffer.from("BIN\0"), buffer]);
  const ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n";
  return {
    "a.stl": "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 0.1 0 0\nvertex 0 0.1 0\nendloop\nendfacet\nendsolid\n",
    "a.obj": "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n",
    "a.ply": `${ply}0 0 0\n0.1 0 0\n0 0.1 0\n3 0 1 2\n`,
    "a.dae": `<COLLADA><asset><unit meter="0.01"/></asset><library_geometries><geometry id="g"><mesh><source id="s"><float_array>0 0 0 10 0 0 0 10 0</float_array></source>
      <vertices id="v"><input semantic="POSITION" source="#s"/></vertices><triangles><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles></mesh></geometry></library_geometries></COLLADA>`,
    "a.gltf": gltf([{ byteLength: buffer.length, uri: `data:application/octet-stream;base64,${buffer.toString("base64")}` }]),
    "a.glb": Buffer.concat([Buffer.from("glTF"), word(2), word(12 + chunks.length), chunks]),
    "cut.ply": `${ply}0 0 0\n0.1 0 0\n`,
    "no.stl": "no triangles",
    "old.3ds": "MM",
  };
}

test("meshes of six formats are drawn, and others are named with the reason", { skip }, async (t) => {
  const files = meshFiles();
  for (const [name, content] of Object.entries(files)) await writeFile(join(folder, "arm", name), content);
  const visuals = Object.keys(files).map((name) => `<visual><origin xyz="0 0 0.6"/><geometry><mesh filename="${name}"/></geometry></visual>`);
  const urdf = await readFile(join(folder, "arm", "arm.urdf"), "utf8");
  await writeFile(join(folder, "arm", "meshes.urdf"), urdf.replace('<link name="torso">', `<link name="torso">${visuals.join("")}`));
  await writeFile(join(folder, "arm", "meshes.toml"), STILL.replace("arm.urdf", "meshes.urdf"));
  const { server, page, complaints } = await open(t, "meshes.toml", ["--keep-going"]);
  const drawn = await page.evaluate(async () => {
    const answers = await Promise.all(Array.from({ length: 7 }, (_, number) => fetch(`mesh/${number}`)));
    return Promise.all(answers.map(async (answer) => (answer.ok ? [...new Float32Array(await answer.arrayBuffer())] : null)));
  });
  const triangle = [...new Float32Array([0, 0, 0, 0.1, 0, 0, 0, 0.1, 0])];
  for (const corners of drawn.slice(0, 6)) corners.forEach((value, k) => assert.ok(Math.abs(value - triangle[k]) < 1e-6, `${corners}`));
  assert.equal(drawn[6], null, "there are six meshes");
  const refused = "no STL file, or cut off: expected one whole";
  const reasons = ["cut.ply is not drawn: vertex 2: expected a number for x", 'old.3ds is not drawn: format "3DS": expected STL, OBJ, PLY, COLLADA (DAE), glTF or GLB'];
  const shown = await page.locator("#not-drawn").textContent();
  for (const reason of [...reasons, `no.stl is not drawn: ${refused}`]) assert.ok(shown.includes(reason), `${reason} is not in ${shown}`);
  assert.equal(await page.locator("#not-drawn summary").textContent(), "3 meshes are not drawn");
  for (const reason of [reasons[0], reasons[1].split(": ")[1], refused]) assert.ok(server.said.some((line) => line.includes(reason)), `${reason} is not in ${server.said.join("\n")}`);
  // The browser complains about the mesh that is not there.
  assert.deepEqual(complaints.filter((text) => !text.includes("404")), []);
});

test("four patches of the demonstration are named, say that they are twins, and nothing is loaded from elsewhere", { skip }, async (t) => {
  const { server, page, complaints, requests } = await open(t, "arm.toml");
  const names = ["forearm", "palm", "chest", "back"];
  assert.deepEqual(await page.locator("#patches tr[data-patch] a").allTextContents(), names);
  assert.deepEqual(await page.locator(".patch-label .name").allTextContents(), names);
  assert.equal(await page.locator(".patch-label .badge.twin").count(), 4);
  assert.equal(await page.locator("#badges .badge").textContent(), "digital twins");
  const first = await state(page);
  await until(page, "moving joints", () => state(page), (now) => Math.abs(now.joints.values.elbow - first.joints.values.elbow) > 0.05);
  assert.ok(await page.locator("#joints input").first().isDisabled(), "the joints follow their source");
  await until(page, "touches of the demonstration", () => touches(page), (rows) => rows.length > 0, 90_000);
  await page.waitForTimeout(1500);
  await keepPicture(page, "body-demonstration");
  // Drawn by the processor, a picture can take longer than the period that this rate is taken over.
  const shown = await until(page, "a picture", () => page.locator("#shown").textContent(), (text) => Number(text) > 0);
  console.log(`${shown} pictures a second`);
  const foreign = requests.filter((url) => new URL(url).host !== new URL(server.address).host);
  assert.deepEqual([foreign, complaints], [[], []]);
});

test("a press in space becomes a touch in the root's frame; states, verdicts and sliders are shown", { skip }, async (t) => {
  const { page, server, complaints } = await open(t, "still.toml", ["--keep-going"]);
  await quiet(page, ["palm", "chest"]);

  await t.test("a patch that failed is shown as failed, with the reason", async () => {
    assert.equal(await chip(page, "back", 2), "failed");
    assert.match(await page.locator('#patches tr[data-patch="back"] + .problem').textContent(), /nowhere\.csv/);
    assert.equal(await page.locator('.patch-label[data-patch="back"] .state').textContent(), "failed");
    assert.equal(await page.locator('#patches tr[data-patch="back"] a').count(), 0, "it has no page");
  });

  await t.test("presses on two skins show where the ray met them, and end", async () => {
    // Frames of a twin may be late on a busy machine, which is stale.
    await until(page, "the guard's verdict", () => page.locator("#verdict").textContent(), (text) => text === "guard: ok");
    await pressed(page, "chest", 12, -8);
    await until(page, "the guard's verdict", () => page.locator("#verdict").textContent(), (text) => text === "guard: stop");
    await until(page, "the verdict at the skin", () => page.locator('.patch-label[data-patch="chest"] .guard').textContent(), (text) => text === "stop");
    await keepPicture(page, "body-pressed");
    await page.mouse.up();
    await until(page, "no touch", () => touches(page), (rows) => rows.length === 0);
    await page.getByRole("button", { name: "Above" }).click();
    const touch = await pressed(page, "palm", 10, 5);
    assert.ok(touch.force_n > 0, "this skin tells forces");
    const arrow = (await state(page)).patches[0].touches[0].in_root;
    assert.ok(arrow.force_n.reduce((sum, part, axis) => sum + part * arrow.normal[axis], 0) < 0, "the force acts on the sensor, against the normal");
    await page.mouse.up();
    await until(page, "no touch", () => touches(page), (rows) => rows.length === 0);
  });

  await t.test("dragging beside the robot turns the view and presses nothing", async () => {
    await page.getByRole("button", { name: "Fit" }).click();
    const before = await place(page, "chest", 0, 0);
    const box = await page.locator("#stage").boundingBox();
    await page.mouse.move(box.x + 20, box.y + box.height - 20);
    await page.mouse.down();
    await page.mouse.move(box.x + 120, box.y + box.height - 60, { steps: 5 });
    await page.mouse.up();
    const after = await place(page, "chest", 0, 0);
    assert.ok(Math.hypot(after.window.x - before.window.x, after.window.y - before.window.y) > 5, "the view turned");
    assert.deepEqual(after.root_mm, before.root_mm);
    await page.getByRole("button", { name: "Fit" }).click();
  });

  await t.test("a slider moves its links", async () => {
    const before = await place(page, "palm", 0, 0);
    const chest = await place(page, "chest", 0, 0);
    await page.locator('#joints tr[data-joint="elbow"] input').fill("1.2");
    await until(page, "the elbow", () => state(page), (now) => Math.abs(now.joints.values.elbow - 1.2) < 0.01);
    await page.waitForTimeout(300);
    const after = await place(page, "palm", 0, 0);
    assert.ok(distance(before.root_mm, after.root_mm) > 100, `${before.root_mm} to ${after.root_mm}`);
    assert.deepEqual((await place(page, "chest", 0, 0)).root_mm, chest.root_mm);
    assert.equal(await page.locator('#joints tr[data-joint="elbow"] .value').textContent(), "68.8°");
  });

  for (const { name, width, height } of WINDOWS) {
    await t.test(`everything fits into ${width} x ${height}`, async () => {
      for (const scheme of ["light", "dark"]) {
        await page.emulateMedia({ colorScheme: scheme });
        await page.setViewportSize({ width, height });
        await page.waitForTimeout(800);
        const seen = await page.evaluate(() => ({
          width: document.documentElement.scrollWidth,
          height: document.documentElement.scrollHeight,
          cut: [...document.querySelectorAll(".side .scroll")].map((box) => box.scrollWidth - box.clientWidth),
          stage: document.querySelector("#stage").getBoundingClientRect().toJSON(),
          labels: [...document.querySelectorAll(".patch-label")].map((label) => label.getBoundingClientRect().toJSON()),
        }));
        await keepPicture(page, `body-${name}-${scheme}`);
        assert.ok(seen.width <= width, `${seen.width} pixels wide`);
        assert.ok(Math.max(...seen.cut) <= 0, `cut off: ${seen.cut}`);
        if (name !== "phone") assert.ok(seen.height <= height, `${seen.height} pixels high`);
        const share = seen.stage.height / height;
        assert.ok(share >= (name === "phone" ? 0.45 : 0.7), `the robot has ${share} of the height`);
        for (const label of seen.labels) assert.ok(label.left >= seen.stage.left - 1 && label.right <= seen.stage.right + 1, JSON.stringify(label));
      }
    });
  }

  await t.test("an accessibility checker finds nothing", async () => {
    await page.setViewportSize({ width: 1280, height: 720 });
    for (const scheme of ["light", "dark"]) {
      await page.emulateMedia({ colorScheme: scheme });
      await page.waitForTimeout(300);
      await page.evaluate(await readFile(axe, "utf8"));
      const found = await page.evaluate(() => window.axe.run(document, { runOnly: ["wcag2a", "wcag2aa"] }));
      assert.deepEqual(found.violations.map(({ id, nodes }) => `${scheme} ${id}: ${nodes.map(({ html }) => html.slice(0, 120))}`), []);
    }
  });

  await t.test("a patch's name opens its own page, which leads back", async () => {
    await page.locator('#patches tr[data-patch="chest"] a').click();
    await page.waitForSelector("[data-connection='live']");
    await page.waitForSelector("#image");
    assert.equal(new URL(page.url()).pathname, "/patch/chest/");
    assert.match(await page.locator("#skin-name").textContent(), /chest/);
    assert.equal(await page.locator("#record").isVisible(), false, "a body is recorded as a whole");
    await until(page, "images", () => page.locator("#shown").textContent(), (text) => Number(text) > 0);
    await keepPicture(page, "body-patch");
    await page.locator(".to-body").click();
    await page.waitForSelector("#stage canvas");
    assert.equal(page.url(), server.address);
  });
  assert.deepEqual(complaints, []);
});

test("touches of patches whose joints are stale are shown on the patch alone", { skip }, async (t) => {
  const { page } = await open(t, "still.toml", ["--keep-going", "--joints", "tcp:127.0.0.1:9"]);
  const rows = await until(page, "touches", () => touches(page), (now) => now.some((row) => row.patch === "palm"), 120_000);
  assert.equal(rows.find((row) => row.patch === "palm").frame, "patch");
  assert.equal(await page.locator("#joints-state").textContent(), "stale");
  assert.equal(await page.locator('.patch-label[data-patch="palm"] .state').textContent(), "joints stale");
  assert.equal(await page.locator('.patch-label[data-patch="chest"] .state').isVisible(), false, "no joint carries the torso");
  await keepPicture(page, "body-stale");
});
