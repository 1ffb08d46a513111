// Builds the page into the folder from which the dermis command embeds it. `node build.mjs --check` builds in memory
// and fails if the committed files differ. `node build.mjs --demo FOLDER` builds the self-contained page: the same
// files, and the worker that runs the skin's module (see scripts/wasm-demo).
import { build } from "esbuild";
import { mkdir, readFile, writeFile } from "node:fs/promises";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const assets = join(here, "../crates/dermis-cli/assets");
const isCheck = process.argv.includes("--check");
const demo = process.argv.includes("--demo") ? process.argv[process.argv.indexOf("--demo") + 1] : null;

/** A library's licence, which requires its text wherever the code goes. */
const licence = async (name, address) => `/*! ${name}, ${address}\n${await readFile(join(here, "node_modules", name.toLowerCase(), "LICENSE"), "utf8")}*/`;
const uPlot = await licence("uPlot", "https://github.com/leeoniya/uPlot");
const three = await licence("three", "https://threejs.org");

const bundle = async (entryPoints, banner) => {
  const { outputFiles } = await build({
    absWorkingDir: here,
    entryPoints,
    outdir: "out",
    bundle: true,
    write: false,
    minify: true,
    format: "iife",
    target: ["es2022"],
    charset: "utf8",
    legalComments: "none",
    banner,
  });
  return outputFiles;
};
const outputFiles = await bundle({ page: "src/main.ts" }, { js: uPlot });
if (demo) outputFiles.push(...(await bundle({ engine: "src/engine.ts" }, {})));
// The page of a body is of no use without a server.
else outputFiles.push(...(await bundle({ body: "src/body/main.ts" }, { js: three })));
const files = new Map(outputFiles.map((file) => [file.path.split(/[\\/]/).pop(), Buffer.from(file.contents)]));
for (const name of ["index.html", "icon.svg", ...(demo ? [] : ["body.html"])]) files.set(name, await readFile(join(here, "public", name)));
// Without their indentation.
for (const [name, contents] of files) if (name.endsWith(".html")) files.set(name, Buffer.from(contents.toString().replace(/\n\s+/g, "\n")));

if (demo) {
  files.set("index.html", Buffer.from(files.get("index.html").toString().replace("<html ", '<html data-engine="engine.js" ')));
  await mkdir(demo, { recursive: true });
  for (const [name, contents] of files) await writeFile(join(demo, name), contents);
  process.exit();
}

let stale = 0;
for (const [name, contents] of [...files].sort()) {
  const path = join(assets, name);
  const committed = await readFile(path).catch(() => null);
  if (committed?.equals(contents)) continue;
  if (isCheck) {
    console.error(`${name} in crates/dermis-cli/assets is not what web/ builds; run: npm --prefix web run build`);
    stale += 1;
  } else {
    await writeFile(path, contents);
    console.log(`wrote ${name}, ${contents.length} bytes`);
  }
}
process.exitCode = stale > 0 ? 1 : 0;
