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

// Its licence requires this text wherever the code goes.
const licence = `/*! uPlot, https://github.com/leeoniya/uPlot\n${await readFile(join(here, "node_modules/uplot/LICENSE"), "utf8")}*/`;

const { outputFiles } = await build({
  absWorkingDir: here,
  entryPoints: { page: "src/main.ts", ...(demo && { engine: "src/engine.ts" }) },
  outdir: "out",
  bundle: true,
  write: false,
  minify: true,
  format: "iife",
  target: ["es2022"],
  charset: "utf8",
  legalComments: "none",
  banner: { js: licence },
});
const files = new Map(outputFiles.map((file) => [file.path.split(/[\\/]/).pop(), Buffer.from(file.contents)]));
for (const name of ["index.html", "icon.svg"]) files.set(name, await readFile(join(here, "public", name)));
// Without its indentation.
files.set("index.html", Buffer.from(files.get("index.html").toString().replace(/\n\s+/g, "\n")));

if (demo) {
  // Only the page contains uPlot.
  files.set("engine.js", Buffer.from(files.get("engine.js").toString().replace(licence, "").trimStart()));
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
