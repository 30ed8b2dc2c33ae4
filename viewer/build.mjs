// Bundles the sources to the one file that the package keeps, and notes beside it what it was made of.
//   node build.mjs          writes src/updyn/viewer/assets/viewer.min.js and viewer.json
//   node build.mjs --check  compares instead: exit 1 where the kept file is not what the sources give
import { build } from "esbuild";
import { createHash } from "node:crypto";
import { readFileSync, readdirSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const assets = join(here, "..", "src", "updyn", "viewer", "assets");
const bundle = join(assets, "viewer.min.js"), record = join(assets, "viewer.json");
const sha256 = (content) => createHash("sha256").update(content).digest("hex");

// Ends of lines do not count: a checkout on Windows gives the same digest.
const text = (path) => readFileSync(path, "utf-8").replaceAll("\r\n", "\n");
const sources = ["build.mjs", "package.json", "package-lock.json", ...readdirSync(join(here, "src")).map((name) => `src/${name}`)];
const digests = Object.fromEntries(sources.sort().map((name) => [name, sha256(text(join(here, name)))]));
const { devDependencies } = JSON.parse(text(join(here, "package.json")));

const made = await build({
  entryPoints: [join(here, "src", "index.js")], absWorkingDir: here,
  bundle: true, minify: true, format: "iife", globalName: "updynViewer", target: "es2022", charset: "ascii",
  legalComments: "eof", loader: { ".css": "text" }, write: false, logLevel: "warning",
});
// Licences of what is bundled: kept whole, where the packages name none within their files.
const licence = (name, file) => `/*! ${name} ${devDependencies[name]}\n${text(join(here, "node_modules", name, file)).trim()}\n*/\n`;
const code = licence("three", "LICENSE") + licence("gifenc", "LICENSE.md") + made.outputFiles[0].text;
const noted = JSON.stringify({ versions: devDependencies, bundle: sha256(code), sources: digests }, null, 1) + "\n";

if (process.argv.includes("--check")) {
  const same = text(bundle) === code && text(record) === noted;
  console.log(same ? "the kept file is what the sources give" : "the kept file differs from what the sources give: run make viewer");
  process.exitCode = same ? 0 : 1;
} else {
  writeFileSync(bundle, code);
  writeFileSync(record, noted);
  console.log(`${bundle}: ${(code.length / 1e6).toFixed(2)} MB`);
}
