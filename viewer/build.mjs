// Bundles the sources to the files that the package keeps, and notes beside each what it was made of.
//   node build.mjs          writes NAME.min.js and NAME.json of each bundle
//   node build.mjs --check  compares instead: exit 1 where a kept file is not what the sources give
import { build } from "esbuild";
import { createHash } from "node:crypto";
import { readFileSync, readdirSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const package_ = join(here, "..", "src", "updyn");
// Each bundle: where it is kept, its sources, the name of what it gives a page, and what of others it holds.
const bundles = [
  { name: "viewer", kept: join(package_, "viewer", "assets"), folder: "src", global: "updynViewer", licences: { three: "LICENSE", gifenc: "LICENSE.md" } },
  { name: "channels", kept: join(package_, "report", "assets"), folder: "channels", global: "updynChannels", licences: { uplot: "LICENSE" } },
];
const sha256 = (content) => createHash("sha256").update(content).digest("hex");

// Ends of lines do not count: a checkout on Windows gives the same digest.
const text = (path) => readFileSync(path, "utf-8").replaceAll("\r\n", "\n");
const { devDependencies } = JSON.parse(text(join(here, "package.json")));
// Licences of what is bundled: kept whole, where the packages name none within their files.
const licence = (name, file) => `/*! ${name} ${devDependencies[name]}\n${text(join(here, "node_modules", name, file)).trim()}\n*/\n`;

async function bundled({ folder, global, licences }) {
  const sources = ["build.mjs", "package.json", "package-lock.json", ...readdirSync(join(here, folder)).map((name) => `${folder}/${name}`)];
  const digests = Object.fromEntries(sources.sort().map((name) => [name, sha256(text(join(here, name)))]));
  const made = await build({
    entryPoints: [join(here, folder, "index.js")], absWorkingDir: here,
    bundle: true, minify: true, format: "iife", globalName: global, target: "es2022", charset: "ascii",
    legalComments: "eof", loader: { ".css": "text" }, write: false, logLevel: "warning",
  });
  const code = Object.entries(licences).map(([name, file]) => licence(name, file)).join("") + made.outputFiles[0].text;
  const versions = Object.fromEntries(Object.keys({ esbuild: 1, ...licences }).sort().map((name) => [name, devDependencies[name]]));
  return [code, JSON.stringify({ versions, bundle: sha256(code), sources: digests }, null, 1) + "\n"];
}

for (const each of bundles) {
  const bundle = join(each.kept, `${each.name}.min.js`), record = join(each.kept, `${each.name}.json`);
  const [code, noted] = await bundled(each);
  if (process.argv.includes("--check")) {
    const same = text(bundle) === code && text(record) === noted;
    console.log(`${each.name}: ${same ? "the kept file is what the sources give" : "the kept file differs from what the sources give: run make viewer"}`);
    if (!same) process.exitCode = 1;
  } else {
    writeFileSync(bundle, code);
    writeFileSync(record, noted);
    console.log(`${bundle}: ${(code.length / 1e6).toFixed(2)} MB`);
  }
}
