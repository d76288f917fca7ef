#!/usr/bin/env bash
# Opens what the pipelines published in a headless Chromium, with three.js and 3d-tiles-renderer, and compares its pictures
# of models with lodge's: .ci/browse.sh [FILE..]
# Pictures come to target/browser/pictures. What is missing is installed where that is possible, else the step is skipped.
set -euo pipefail
cd "$(dirname "$0")/.."
here=$PWD
files=("$@")
if [ ${#files[@]} -eq 0 ]; then
  files=(out/town/tileset/tileset.json)
  for file in out/impostor/*.glb; do [ ! -f "$file" ] || files+=("$file"); done
  # What tests/views.rs kept: models with lodge's own pictures, to which three.js must agree.
  for file in target/tmp/views/*.views.json; do [ ! -f "$file" ] || files+=("$file"); done
fi
for i in "${!files[@]}"; do
  if [ ! -f "${files[$i]}" ]; then
    echo "skipped: browser: no ${files[$i]} (lodge run pipelines/town.toml)"
    exit 0
  fi
  files[i]=$(realpath "${files[$i]}")
done
if ! command -v node >/dev/null || ! command -v npm >/dev/null; then
  echo 'skipped: browser: no node or npm'
  exit 0
fi
if ! command -v chromium-headless-shell >/dev/null && ! command -v chromium >/dev/null; then
  { command -v apt-get && apt-get update && apt-get install -y --no-install-recommends chromium-headless-shell; } >/dev/null 2>&1 || true
fi
if ! command -v chromium-headless-shell >/dev/null && ! command -v chromium >/dev/null; then
  echo 'skipped: browser: no Chromium, and none could be installed'
  exit 0
fi
mkdir -p target/browser
cd target/browser
[ -f package.json ] || echo '{"private": true}' >package.json
if [ ! -d node_modules/playwright-core ] || [ ! -d node_modules/three ]; then
  if ! npm install --no-fund --no-audit --silent \
    three@0.187.0 3d-tiles-renderer@0.5.3 esbuild@0.25 playwright-core@1.65.1 >/dev/null 2>&1; then
    echo 'skipped: browser: npm could not install three, 3d-tiles-renderer, esbuild and playwright-core'
    exit 0
  fi
fi
NODE_PATH=$PWD/node_modules node_modules/.bin/esbuild "$here/.ci/browser/page.js" \
  --bundle --format=esm --minify --log-level=warning --outfile=page.js
node "$here/.ci/browser/browse.mjs" page.js pictures "${files[@]}"
