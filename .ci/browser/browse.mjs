// Opens what was written in a headless Chromium, with three.js and 3d-tiles-renderer: node browse.mjs BUNDLE PICTURES FILE..
// A file is a tileset.json or a .glb. Each must draw; a tileset also refines, answers a click, and loads nothing but its own files.
import { createServer } from 'node:http';
import { createRequire } from 'node:module';
import { existsSync, mkdirSync, readFileSync, writeFileSync } from 'node:fs';
import { basename, dirname, join, resolve } from 'node:path';

const require = createRequire(join(process.cwd(), 'here.js'));
const { chromium } = require('playwright-core');
const [bundle, pictures, ...files] = process.argv.slice(2);
const page_html = '<!doctype html><link rel="icon" href="data:,"><body style="margin:0"><script type="module" src="/page.js"></script>';

let root = '/';
const server = createServer((request, response) => {
  const path = decodeURIComponent(new URL(request.url, 'http://x').pathname);
  if (path === '/') return response.setHeader('content-type', 'text/html').end(page_html);
  const file = path === '/page.js' ? bundle : join(root, path.replace(/^\/data\//, ""));
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
  await page.close();
  console.log(`${file}: ${problems.length ? 'WRONG' : 'drawn'}; ${say.join('; ')}`);
  for (const p of problems.slice(0, 10)) console.log(`  ${p}`);
  bad += problems.length;
}
await browser.close();
server.close();
process.exit(bad ? 1 : 0);
