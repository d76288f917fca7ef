// Draws a model as lodge's pictures of 14 sides do (io/views.rs), and compares pixel by pixel.
import { Color, DoubleSide, LinearFilter, MeshBasicMaterial, Matrix4, OrthographicCamera, Scene, Vector3, WebGLRenderer } from 'three';
import { GLTFLoader } from 'three/examples/jsm/loaders/GLTFLoader.js';

/** z up to y up. */
const turned = ([x, y, z]) => new Vector3(x, z, -y);

/**
 * Base colours without light; what shines through is drawn whole or not at all. `sharp`: from the largest copy of a picture
 * alone, since graphics cards choose the copy by other rules than ours, and alpha fades in theirs.
 */
function plain(material, sharp) {
  const { map, color, side, vertexColors, opacity, transparent, alphaTest } = material;
  if (map && sharp) {
    map.minFilter = LinearFilter;
    map.generateMipmaps = false;
  }
  return new MeshBasicMaterial({
    map: map ?? null, color: color ?? new Color(1, 1, 1), side, vertexColors, opacity,
    alphaTest: transparent ? 0.5 : alphaTest,
  });
}

/**
 * `spec`: side in pixels, half extent, middle, axes (right, up, to the eye) of each view; `ours`: RGBA of them all, rows
 * from the top, alpha 0 where nothing is. Per view: pixels that either draws, those of them at an edge (a neighbour is not
 * drawn), that one alone draws, of these the deep ones (all around them the two disagree, too); of those that both draw the
 * mean difference of a channel, and the share that is far off.
 */
window.compare = async (url, spec, oursUrl) => {
  const { side, half, middle, views } = spec;
  const ours = new Uint8Array(await (await fetch(oursUrl)).arrayBuffer());
  const renderer = new WebGLRenderer({ antialias: false, alpha: true, preserveDrawingBuffer: true });
  renderer.setPixelRatio(1);
  renderer.setSize(side, side);
  renderer.setClearColor(0, 0);
  const scene = new Scene();
  const { scene: model } = await new GLTFLoader().loadAsync(url);
  let triangles = 0;
  model.traverse((o) => {
    if (!o.isMesh) {
      if (o.isPoints || o.isLine) o.visible = false;
      return;
    }
    o.frustumCulled = false;
    o.material = plain(o.material, spec.sharp);
    // Without a material both sides are seen.
    if (spec.bare) o.material.side = DoubleSide;
    triangles += (o.geometry.index ?? o.geometry.attributes.position).count / 3;
  });
  scene.add(model);
  const camera = new OrthographicCamera(-half, half, half, -half, 0, 4 * half);
  camera.matrixAutoUpdate = false;
  const n = side * side, gl = renderer.getContext(), theirs = new Uint8Array(4 * n);
  const sheet = document.createElement('canvas'), small = side / 2;
  [sheet.width, sheet.height] = [7 * small, small * 3 * Math.ceil(views.length / 7)];
  const paper = sheet.getContext('2d');
  const out = [];
  for (const [v, axes] of views.entries()) {
    const [right, up, eye] = axes.map(turned);
    camera.matrix = new Matrix4().makeBasis(right, up, eye).setPosition(turned(middle).addScaledVector(eye, 2 * half));
    camera.updateMatrixWorld(true);
    camera.updateProjectionMatrix();
    renderer.render(scene, camera);
    gl.readPixels(0, 0, side, side, gl.RGBA, gl.UNSIGNED_BYTE, theirs);
    const a = (x, y) => 4 * (v * n + y * side + x), b = (x, y) => 4 * ((side - 1 - y) * side + x);
    const drawn = (x, y) => ours[a(x, y) + 3] > 0 && theirs[b(x, y) + 3] > 0;
    const differ = (x, y) => (ours[a(x, y) + 3] > 0) !== (theirs[b(x, y) + 3] > 0);
    const row = { either: 0, edge: 0, ours: 0, theirs: 0, deep: 0, off: 0, far: 0, both: 0 };
    const images = [0, 1, 2].map(() => new ImageData(side, side));
    for (let y = 0; y < side; y++) {
      for (let x = 0; x < side; x++) {
        const [p, q, r] = [a(x, y), b(x, y), 4 * (y * side + x)];
        const [mine, yours] = [ours[p + 3] > 0, theirs[q + 3] > 0];
        const sum = [0, 1, 2].reduce((s, k) => s + Math.abs(ours[p + k] - theirs[q + k]), 0);
        for (let k = 0; k < 3; k++) {
          images[0].data[r + k] = mine ? ours[p + k] : 230;
          images[1].data[r + k] = yours ? theirs[q + k] : 230;
          images[2].data[r + k] = mine && yours ? 255 - Math.min(255, sum) : 255;
        }
        for (const image of images) image.data[r + 3] = 255;
        if (!mine && !yours) continue;
        row.either++;
        if ([[x - 1, y], [x + 1, y], [x, y - 1], [x, y + 1]].some(([i, j]) => !drawn(i, j))) row.edge++;
        if (mine && yours) {
          row.both++;
          row.off += sum / 3;
          if (sum > 120) row.far++;
          continue;
        }
        row[mine ? 'ours' : 'theirs']++;
        images[2].data.set(mine ? [255, 0, 0] : [0, 0, 255], r);
        let all = true;
        for (let dy = -1; dy <= 1; dy++) {
          for (let dx = -1; dx <= 1; dx++) {
            const [i, j] = [x + dx, y + dy];
            all &&= i >= 0 && j >= 0 && i < side && j < side && differ(i, j);
          }
        }
        if (all) row.deep++;
      }
    }
    row.off /= Math.max(1, row.both);
    row.far /= Math.max(1, row.both);
    out.push(row);
    for (const [k, image] of images.entries()) {
      const bitmap = await createImageBitmap(image);
      paper.drawImage(bitmap, (v % 7) * small, (3 * Math.floor(v / 7) + k) * small, small, small);
    }
  }
  return { triangles, bits: gl.getParameter(gl.SUBPIXEL_BITS), rows: out, sheet: sheet.toDataURL('image/png') };
};
