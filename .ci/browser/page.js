// What a browser shows of a tileset or a model, for browse.mjs: `show(url)`, then `look(..)` and `pick(..)`.
import {
  Box3, Color, DirectionalLight, HemisphereLight, Matrix4, PerspectiveCamera, Raycaster, Scene, Sphere, Vector2,
  Vector3, WebGLRenderer,
} from 'three';
import { GLTFLoader } from 'three/examples/jsm/loaders/GLTFLoader.js';
import { TilesRenderer } from '3d-tiles-renderer';
import { GLTFExtensionsPlugin } from '3d-tiles-renderer/plugins';
import './views.js';

const [width, height] = [1024, 640];
const renderer = new WebGLRenderer({ antialias: false, preserveDrawingBuffer: true });
renderer.setPixelRatio(1);
renderer.setSize(width, height);
document.body.append(renderer.domElement);
const scene = new Scene();
scene.background = new Color(0xff00ff);
scene.add(new HemisphereLight(0xffffff, 0x888888, 2), new DirectionalLight(0xffffff, 1));
const camera = new PerspectiveCamera(60, width / height, 1, 1e6);
let tiles, up = new Vector3(0, 1, 0), ball = new Sphere();

const frame = () => new Promise((done) => requestAnimationFrame(done));

/** Loads a tileset.json or a .glb; gives the radius of what there is to see, in metres. */
window.show = async (url) => {
  if (url.endsWith('.glb')) {
    const { scene: model } = await new GLTFLoader().loadAsync(url);
    scene.add(model);
    new Box3().setFromObject(model).getBoundingSphere(ball);
    return ball.radius;
  }
  tiles = new TilesRenderer(url);
  tiles.registerPlugin(new GLTFExtensionsPlugin({ metadata: true }));
  tiles.setCamera(camera);
  tiles.setResolutionFromRenderer(camera, renderer);
  scene.add(tiles.group);
  for (let i = 0; i < 2000 && !tiles.getBoundingSphere(ball); i++) { tiles.update(); await frame(); }
  up = ball.center.clone().normalize();
  return ball.radius;
};

/** Looks at the middle from `distance` metres, at `pitch` degrees above the horizon, turned by `turn` degrees. */
window.look = async (distance, pitch, turn = 0) => {
  const east = new Vector3(0, 0, 1).cross(up).normalize();
  if (!east.lengthSq()) east.set(1, 0, 0);
  const north = up.clone().cross(east);
  const [p, t] = [pitch * Math.PI / 180, turn * Math.PI / 180];
  const from = north.multiplyScalar(-Math.cos(t)).addScaledVector(east, Math.sin(t)).multiplyScalar(Math.cos(p))
    .addScaledVector(up, Math.sin(p));
  camera.position.copy(ball.center).addScaledVector(from, distance);
  camera.up.copy(up);
  camera.near = distance / 100;
  camera.far = distance * 100;
  camera.lookAt(ball.center);
  camera.updateProjectionMatrix();
  camera.updateMatrixWorld();
  let quiet = 0;
  for (let i = 0; tiles && i < 5000 && quiet < 5; i++) {
    tiles.update();
    quiet = tiles.loadProgress === 1 ? quiet + 1 : 0;
    await frame();
  }
  renderer.render(scene, camera);
  const gl = renderer.getContext(), pixels = new Uint8Array(4 * width * height);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  let drawn = 0;
  for (let i = 0; i < pixels.length; i += 4) {
    if (Math.abs(pixels[i] - 255) + pixels[i + 1] + Math.abs(pixels[i + 2] - 255) > 6) drawn++;
  }
  return {
    drawn: drawn / (width * height), triangles: renderer.info.render.triangles,
    tiles: tiles ? tiles.visibleTiles.size : 1, errors: tiles ? [...tiles.activeTiles].filter((t) => t.error > 16).length : 0,
  };
};

/** What a click on a pixel finds: the feature's row of the property table, and where it was hit. */
window.pick = async (x, y) => {
  const ray = new Raycaster();
  ray.setFromCamera(new Vector2((2 * x) / width - 1, 1 - (2 * y) / height), camera);
  const [hit] = ray.intersectObject(tiles ? tiles.group : scene, true);
  if (!hit) return null;
  const { meshFeatures, structuralMetadata } = hit.object.userData;
  const bary = hit.barycoord ?? new Vector3(1, 0, 0);
  const [feature] = await meshFeatures.getFeaturesAsync(hit.faceIndex, bary);
  const at = tiles.group.worldToLocal(hit.point.clone()).toArray();
  return { feature, row: structuralMetadata.getPropertyTableData([0], [feature])[0], at };
};
window.ready = true;
