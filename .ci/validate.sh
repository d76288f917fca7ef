#!/usr/bin/env bash
# The Khronos glTF validator, the 3D Tiles and the CityJSON schemas over everything that was written:
# .ci/validate.sh [FOLDER..]
# Folders: what the tests keep (of write-glb, too), and what the pipelines published. Schemas: $LODGE_DATA/peer/3dtiles-schema and cityjson.
set -euo pipefail
cd "$(dirname "$0")/.."
here=$PWD
folders=()
for folder in "${@:-}"; do [ -n "$folder" ] && folders+=("$(realpath "$folder")"); done
if [ ${#folders[@]} -eq 0 ]; then
  for folder in target/tmp/tilesets target/tmp/cityjson target/tmp/views out .lodge/out pipelines/out; do
    if [ -d "$folder" ]; then folders+=("$here/$folder"); fi
  done
fi
if [ ${#folders[@]} -eq 0 ]; then
  echo 'skipped: validators: nothing written yet (cargo test --test tileset)'
  exit 0
fi
if ! command -v node >/dev/null || ! command -v npm >/dev/null; then
  echo 'skipped: validators: no node or npm'
  exit 0
fi
scratch=$here/target/validators
mkdir -p "$scratch"
cd "$scratch"
if [ ! -d node_modules/gltf-validator ] || [ ! -d node_modules/ajv ]; then
  [ -f package.json ] || echo '{"private": true}' >package.json
  if ! npm install --no-fund --no-audit --silent gltf-validator@2.0.0-dev.3.10 ajv@8 >/dev/null 2>&1; then
    echo 'skipped: validators: npm could not install gltf-validator and ajv'
    exit 0
  fi
fi
schemas=${LODGE_DATA:+$LODGE_DATA/peer/3dtiles-schema}
if [ ! -d "${schemas:-/nowhere}" ]; then
  echo 'skipped: 3D Tiles schemas: LODGE_DATA is not set or has none'
  schemas=
fi
city=${LODGE_DATA:+$LODGE_DATA/peer/cityjson}
if [ ! -f "${city:-/nowhere}/cityjson.min.schema.json" ]; then
  echo 'skipped: CityJSON schemas: LODGE_DATA is not set or has none'
  city=
fi
node "$here/.ci/validate.mjs" "$schemas" "$city" "${folders[@]}"
