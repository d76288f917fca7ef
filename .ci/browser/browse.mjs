// Opens what was written in a headless Chromium, with three.js and 3d-tiles-renderer: node browse.mjs BUNDLE PICTURES FILE..
// A file is a tileset.json or a .glb. Each must draw; a tileset also refines, answers a click, and loads nothing but its own files.
// Or a .views.json, which tests/views.rs keeps: lodge's pictures of a model from 14 sides, with which three.js must agree.
import { createServer } from 'node:http';
import { createRequire } from 'node:module';
import { existsSync, mkdirSync, readFileSync, writeFileSync } from 'node:fs';
import { basename, dirname, join, resolve } from 'node:path';

const require = createRequire(join(process.cwd(), 'here.js'));
const { chromium } = require('playwright-core');
const [bundle, pictures, ...files] = process.argv.slice(2);
const page_html = '<!doctype html><link rel="icon" href="data:,"><body style="margin:0"><script type="module" src="/page.js"></script>';

let root = '/', beside = '/';
const server = createServer((request, response) => {
  const path = decodeURIComponent(new URL(request.url, 'http://x').pathname);
  if (path === '/') return response.setHeader('content-type', 'text/html').end(page_html);
  const file = path === '/page.js' ? bundle : path.startsWith('/model/') ? join(beside, path.slice(7)) : join(root, path.replace(/^\/data\//, ""));
  if (!existsSync(file)) return response.writeHead(404).end();
  if (path === '/page.js') response.setHeader('content-type', 'text/javascript');
  response.end(readFileSync(file));
}).listen(0, '127.0.0.1');
await new Promise((done) => server.on('listening', done));
const here = `http://127.0.0.1:${server.address().port}`;

const executablePath = ['chromium-headless-shell', 'chromium', 'google-chrome']
  .flatMap((name) => process.env.PATH.split(':').map((p) => join(p, name))).find(existsSync);
const browser = await chromium.launch({
  executablePath,
  args: ['--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--no-sandbox', '--disable-background-networking',
    '--force-color-profile=srgb', '--force-device-scale-factor=1'],
});
mkdirSync(pictures, { recursive: true });
let bad = 0;

async function report(page, file, problems, say) {
  await page.close();
  console.log(`${file}: ${problems.length ? 'WRONG' : 'drawn'}; ${say.join('; ')}`);
  for (const p of problems.slice(0, 10)) console.log(`  ${p}`);
  bad += problems.length;
}

async function compare(page, file, expect, say) {
  const spec = JSON.parse(readFileSync(file, 'utf8'));
  beside = dirname(spec.model);
  const url = `${here}/model/${basename(spec.model)}`;
  const { triangles, bits, rows, sheet } = await page.evaluate(([url, spec, ours]) => window.compare(url, spec, ours),
    [url, spec, `${here}/data/${basename(file).replace(/json$/, 'rgba')}`]);
  writeFileSync(join(pictures, basename(file).replace(/json$/, 'png')), Buffer.from(sheet.split(',')[1], 'base64'));
  const sum = (key) => rows.reduce((s, r) => s + r[key], 0);
  const mean = (key) => rows.reduce((s, r) => s + r[key] * r.both, 0) / sum('both');
  if (process.env.VIEWS) rows.forEach((r, i) => console.log(i, JSON.stringify(r)));
  const differ = sum('ours') + sum('theirs'), edge = sum('edge');
  say.push(`${triangles} triangles, ${rows.length} views: ${sum('either')} pixels, ${edge} at edges, drawn by lodge alone `
    + `${sum('ours')}, by three alone ${sum('theirs')} (${(100 * differ / edge).toFixed(2)} % of the edges'), deep `
    + `${sum('deep')}; colours off by ${mean('off').toFixed(2)} of 255, far off ${(100 * mean('far')).toFixed(2)} %`);
  // Both put corners on a grid within a pixel, the browser on 1/16, lodge on 1/256: edges move by 1/64 of a pixel in the
  // mean, 1/32 at most, and as large a share of their pixels changes sides (seen: 1.1 to 3.1 %; a level edge near a
  // row's middle changes as a whole). Nothing else may, so never a pixel with all around it. Smaller copies of a picture
  // with alpha fade at their edges in a browser (6.5 % of a tree's).
  const most = spec.sharp ? 0.04 : 0.08;
  expect(sum('either') > 0.02 * rows.length * spec.side ** 2, 'hardly anything is drawn');
  expect(bits >= 4, `corners lie on 1/${2 ** bits} of a pixel`);
  expect(differ <= most * edge, `${differ} pixels differ, more than ${100 * most} % of the edges'`);
  expect(sum('deep') <= (spec.sharp ? 0 : 4), `${sum('deep')} pixels differ where all around differ`);
  expect(mean('off') < (spec.sharp ? 1 : 4), `colours are off by ${mean('off')}`);
  expect(mean('far') < (spec.sharp ? 0.003 : 0.015), `${100 * mean('far')} % of the colours are far off`);
}

for (const file of files) {
  const problems = [], name = basename(file).replace(/\W/g, '-'), say = [];
  const expect = (holds, what) => { if (!holds) problems.push(what); };
  const page = await browser.newPage({ viewport: { width: 1024, height: 640 } });
  page.setDefaultTimeout(120_000);
  page.on('console', (m) => { if (m.type() === 'error') problems.push(m.text()); });
  page.on('response', (r) => { if (!r.ok()) problems.push(`${r.status()} ${r.url()}`); });
  page.on('pageerror', (e) => problems.push(String(e)));
  page.on('request', (r) => { if (!/^(blob|data):/.test(r.url()) && !r.url().startsWith(here)) problems.push(`asks for ${r.url()}`); });
  root = dirname(resolve(file));
  await page.goto(here);
  await page.waitForFunction('window.ready');
  if (file.endsWith('.views.json')) {
    await compare(page, file, expect, say);
    await report(page, file, problems, say);
    continue;
  }
  const radius = await page.evaluate((url) => window.show(url), `${here}/data/${basename(file)}`);
  const shot = async (what) => writeFileSync(join(pictures, `${name}-${what}.png`), await page.screenshot());
  const far = await page.evaluate((d) => window.look(d, 45), radius * 2);
  await shot('far');
  say.push(`radius ${radius.toFixed(0)} m, far: ${far.tiles} tiles, ${far.triangles} triangles, ${(100 * far.drawn).toFixed(1)} % drawn`);
  expect(far.drawn > 0.01, `only ${far.drawn} of the picture is drawn`);
  if (file.endsWith('.json')) {
    const near = await page.evaluate((d) => window.look(d, 30, 30), radius / 6);
    await shot('near');
    say.push(`near: ${near.tiles} tiles, ${near.triangles} triangles, ${(100 * near.drawn).toFixed(1)} %`);
    expect(near.drawn > 0.05, `only ${near.drawn} of the near picture is drawn`);
    expect(near.errors === 0, `${near.errors} tiles coarser than asked`);
    let clicked;
    for (let i = 0; i < 60 && !clicked; i++) {
      clicked = await page.evaluate(([x, y]) => window.pick(x, y), [64 + 128 * (i % 8), 600 - 70 * Math.floor(i / 8)]);
    }
    expect(clicked?.row?.source_count > 0, `a click finds ${JSON.stringify(clicked)}`);
    if (clicked) say.push(`a click: ${JSON.stringify(clicked.row)}`);
  }
  await report(page, file, problems, say);
}
await browser.close();
server.close();
process.exit(bad ? 1 : 0);
