// Builds the page into the folder from which the dermis command embeds it. `node build.mjs --check` builds into memory
// and fails when the committed files differ.
import { build } from "esbuild";
import { readFile, writeFile } from "node:fs/promises";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const assets = join(here, "../crates/dermis-cli/assets");
const isCheck = process.argv.includes("--check");

// Its licence asks that this text goes wherever the code goes.
const licence = `/*! uPlot, https://github.com/leeoniya/uPlot\n${await readFile(join(here, "node_modules/uplot/LICENSE"), "utf8")}*/`;

const { outputFiles } = await build({
  absWorkingDir: here,
  entryPoints: { page: "src/main.ts" },
  outdir: "out",
  bundle: true,
  write: false,
  minify: true,
  format: "iife",
  target: ["es2022"],
  charset: "utf8",
  legalComments: "none",
  banner: { js: licence, css: licence },
});
const files = new Map(outputFiles.map((file) => [file.path.split(/[\\/]/).pop(), Buffer.from(file.contents)]));
for (const name of ["index.html", "icon.svg"]) files.set(name, await readFile(join(here, "public", name)));

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
