// Holds every GLB, tileset.json and CityJSON below the folders named against the Khronos validator and the JSON schemas.
// node validate.mjs TILES CITY FOLDER..; TILES and CITY are folders of schemas and may be "" (then those files are only
// counted). Exit 1 where anything is wrong.
import { createRequire } from 'node:module';
import { readFileSync, readdirSync, statSync } from 'node:fs';
import { join, relative } from 'node:path';

// Resolved from the working directory: that is where npm put them.
const require = createRequire(join(process.cwd(), 'here.js'));
const validator = require('gltf-validator');
const Ajv = require('ajv/dist/2020');
const AjvDraft7 = require('ajv');

const [schemas, citySchemas, ...folders] = process.argv.slice(2);
const walk = (at) => statSync(at).isDirectory()
  ? readdirSync(at).sort().flatMap((name) => walk(join(at, name))) : [at];

// Extensions that the validator only knows by name, and sizes of pictures that are kept as they came; anything it says
// beside that is ours.
const UNKNOWN = new Set(['UNSUPPORTED_EXTENSION', 'UNUSED_OBJECT', 'IMAGE_NPOT_DIMENSIONS']);
let bad = 0;
const wrong = (file, what) => { if (bad++ < 20) console.log(`${file}: ${what}`); };

let holds = () => {};
if (schemas) {
  const ajv = new Ajv({ strict: false, allErrors: true });
  const all = walk(schemas).filter((f) => f.endsWith('.schema.json'));
  // Files refer to each other by place.
  for (const file of all) {
    const schema = JSON.parse(readFileSync(file, 'utf8'));
    schema.$id = 'https://schemas/' + relative(schemas, file);
    ajv.addSchema(schema);
  }
  holds = (file, name, data) => {
    const check = ajv.getSchema('https://schemas/' + name);
    if (!check(data)) wrong(file, `${name}: ${ajv.errorsText(check.errors)}`);
  };
}

// CityJSON's schemas come as one file a kind of object.
const cityHolds = {};
if (citySchemas) {
  for (const [type, name] of [['CityJSON', 'cityjson'], ['CityJSONFeature', 'cityjsonfeature']]) {
    const ajv = new AjvDraft7({ strict: false, validateFormats: false });
    const check = ajv.compile(JSON.parse(readFileSync(join(citySchemas, `${name}.min.schema.json`), 'utf8')));
    cityHolds[type] = (file, data) => { if (!check(data)) wrong(file, `${name}: ${ajv.errorsText(check.errors)}`); };
  }
}
const city = (file, data) => {
  if (data.type !== 'CityJSON' && data.type !== 'CityJSONFeature') wrong(file, `type is ${data.type}`);
  else cityHolds[data.type]?.(file, data);
};

const counts = { glb: 0, tilesets: 0, cities: 0 };
for (const file of folders.flatMap(walk)) {
  if (file.endsWith('.city.json')) {
    counts.cities++;
    city(file, JSON.parse(readFileSync(file, 'utf8')));
    continue;
  }
  if (file.endsWith('.city.jsonl')) {
    counts.cities++;
    const lines = readFileSync(file, 'utf8').split('\n').filter((line) => line);
    lines.forEach((line, i) => city(`${file}:${i + 1}`, JSON.parse(line)));
    continue;
  }
  if (file.endsWith('tileset.json')) {
    counts.tilesets++;
    holds(file, 'tileset.schema.json', JSON.parse(readFileSync(file, 'utf8')));
  } else if (file.endsWith('.glb')) {
    counts.glb++;
    const bytes = new Uint8Array(readFileSync(file));
    const report = await validator.validateBytes(bytes, { maxIssues: 20 });
    for (const m of report.issues.messages) {
      if (m.severity <= 1 || !UNKNOWN.has(m.code)) wrong(file, `${m.code}: ${m.message} ${m.pointer ?? ''}`);
    }
    const size = new DataView(bytes.buffer, bytes.byteOffset).getUint32(12, true);
    const json = JSON.parse(new TextDecoder().decode(bytes.subarray(20, 20 + size)));
    const metadata = json.extensions?.EXT_structural_metadata;
    if (metadata) {
      holds(file, 'Schema/schema.schema.json', metadata.schema);
      metadata.propertyTables.forEach((t) => holds(file, 'PropertyTable/propertyTable.schema.json', t));
    }
  }
}
console.log(`${counts.glb} GLB, ${counts.tilesets} tileset.json, ${counts.cities} CityJSON: `
  + (bad ? `${bad} complaints` : 'clean') + (schemas ? '' : ' (no schemas: tileset.json not checked)')
  + (citySchemas ? '' : ' (no schemas: CityJSON not checked)'));
process.exit(bad ? 1 : 0);
