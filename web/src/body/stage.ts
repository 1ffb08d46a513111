// The view of the robot: camera, light, ground and the labels over it. Draws only what has changed.

import * as THREE from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import type { Robot } from "./robot";

/** Directions from which to look, root's frame: x forward, y left, z up. */
export const VIEWS = { fit: [1, -0.6, 0.5], front: [1, 0, 0.0001], left: [0, 1, 0.0001], back: [-1, 0, 0.0001], above: [0.0001, 0, 1] } as const;
export type ViewName = keyof typeof VIEWS;

/** Largest share of the view's height and width filled by the robot; the rest is for names. */
const FILL = 0.92;
/** Size of a cell of space, metres, and most cells to remember. */
const SEEN_M = 0.05;
const MOST_SEEN = 20_000;
/** Length of the root's axes, metres. */
const AXES_M = 0.15;
/** Turn and zoom of a key press. */
const KEY_TURN = Math.PI / 24;
const KEY_ZOOM = 1.1;

/** True if the processor draws instead of a graphics card: then shadows and smooth edges cost too much. */
function drawsByProcessor(): boolean {
  const context = document.createElement("canvas").getContext("webgl2");
  const more = context?.getExtension("WEBGL_debug_renderer_info");
  const name = String(context?.getParameter(more?.UNMASKED_RENDERER_WEBGL ?? context.RENDERER));
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
}

/** A renderer; null if the browser has no WebGL 2. */
function openRenderer(): THREE.WebGLRenderer | null {
  const isSlow = drawsByProcessor();
  try {
    const renderer = new THREE.WebGLRenderer({ antialias: !isSlow, alpha: true });
    renderer.setPixelRatio(isSlow ? 1 : Math.min(window.devicePixelRatio, 2));
    renderer.shadowMap.enabled = !isSlow;
    return renderer;
  } catch {
    return null;
  }
}

export class Stage {
  readonly camera = new THREE.PerspectiveCamera(35, 1, 0.01, 100);
  readonly controls: OrbitControls;
  readonly canvas: HTMLCanvasElement;
  /** Pictures drawn. */
  drawn = 0;
  /** Called before a picture is drawn. */
  beforeDrawing: () => void = () => {};
  /** Null without WebGL: then only the lists are shown. */
  private readonly renderer: THREE.WebGLRenderer | null;
  private readonly scene = new THREE.Scene();
  private readonly grid = new THREE.Group();
  private readonly light = new THREE.DirectionalLight(0xffffff, 1.9);
  private isStale = true;
  private robot: Robot | null = null;
  /** Places where the robot has been, one per cell of space. */
  private readonly seen = new Map<string, THREE.Vector3>();
  /** The view that follows the robot until the user moves the camera. */
  private followed: ViewName | null = "fit";

  constructor(private readonly place: HTMLElement) {
    THREE.Object3D.DEFAULT_UP.set(0, 0, 1);
    this.camera.up.set(0, 0, 1);
    this.renderer = openRenderer();
    this.canvas = this.renderer?.domElement ?? document.createElement("canvas");
    place.prepend(this.canvas);
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.enableDamping = false;
    this.controls.minDistance = 0.05;
    this.controls.maxDistance = 50;
    this.controls.addEventListener("change", () => this.touch());
    this.controls.addEventListener("start", () => (this.followed = null));
    this.light.position.set(1.5, 1.2, 3);
    this.light.castShadow = true;
    this.light.shadow.mapSize.set(2048, 2048);
    this.light.shadow.radius = 5;
    this.light.shadow.bias = -1e-3;
    const fill = new THREE.DirectionalLight(0xffffff, 0.5);
    fill.position.set(-2, -1.5, 1);
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x8a8f98, 1.5), this.light, fill, this.grid);
    new ResizeObserver(() => this.resize()).observe(place);
    place.addEventListener("keydown", (event) => this.key(event));
    // Keep a drag from selecting text.
    this.canvas.addEventListener("mousedown", (event) => {
      event.preventDefault();
      place.focus({ preventScroll: true });
    });
    this.resize();
    const loop = () => {
      this.draw();
      requestAnimationFrame(loop);
    };
    requestAnimationFrame(loop);
  }

  /** False if the browser can't draw the robot. */
  get draws(): boolean {
    return this.renderer !== null;
  }

  begin(robot: Robot): void {
    if (this.robot) this.scene.remove(this.robot.group);
    this.robot = robot;
    this.scene.add(robot.group);
    this.seen.clear();
    this.followed = "fit";
  }

  /** The robot has moved. The view widens to include it, unless the user has moved the camera. */
  moved(): void {
    const before = this.seen.size;
    for (const point of this.robot?.corners() ?? []) {
      const key = point.toArray().map((m) => Math.round(m / SEEN_M)).join();
      if (!this.seen.has(key) && this.seen.size < MOST_SEEN) this.seen.set(key, point);
    }
    if (this.seen.size > before && this.followed) this.view(this.followed);
    this.touch();
  }

  /** Something has changed: draw again. */
  touch(): void {
    this.isStale = true;
  }

  /** Colours of the ground and the robot, from the page's style. */
  paint(): void {
    const style = getComputedStyle(this.place);
    const colour = (name: string) => style.getPropertyValue(name).trim();
    this.robot?.paint(colour("--link"), colour("--link-edge"));
    this.ground(colour("--grid-minor"), colour("--grid-major"));
    this.touch();
  }

  /** The ground under the robot: squares of 10 cm, every fifth line stronger, and the root's axes. */
  private ground(minor: string, major: string): void {
    this.grid.clear();
    if (!this.robot) return;
    const box = new THREE.Box3().setFromPoints(this.robot.corners());
    const size = box.getSize(new THREE.Vector3());
    const half = Math.max(1, Math.ceil(1.2 * Math.max(size.x, size.y)));
    const lines = (step: number, colour: string) => {
      const grid = new THREE.GridHelper(2 * half, Math.round((2 * half) / step), colour, colour).rotateX(Math.PI / 2);
      grid.position.z = Math.min(box.min.z, 0) - 1e-3;
      return grid;
    };
    const axes = new THREE.AxesHelper(AXES_M);
    // Visible through the link around them.
    Object.assign(axes.material, { depthTest: false, transparent: true, opacity: 0.9 });
    axes.renderOrder = 2;
    // Only the ground shows shadows; on the robot they would obscure the colours of a skin.
    const ground = new THREE.Mesh(new THREE.PlaneGeometry(4 * half, 4 * half), new THREE.ShadowMaterial({ opacity: 0.13 }));
    ground.position.z = Math.min(box.min.z, 0) - 2e-3;
    ground.receiveShadow = true;
    Object.assign(this.light.shadow.camera, { left: -half, right: half, top: half, bottom: -half, near: 0.1, far: 10 * half });
    this.light.shadow.camera.updateProjectionMatrix();
    this.grid.add(ground, lines(0.1, minor), lines(0.5, major), axes);
  }

  /** Looks at all places where the robot has been, from one side. */
  view(name: ViewName): void {
    if (this.seen.size === 0) return;
    this.followed = name;
    const back = new THREE.Vector3(...VIEWS[name]).normalize();
    const right = new THREE.Vector3().crossVectors(this.camera.up, back).normalize();
    const up = new THREE.Vector3().crossVectors(back, right);
    // The nearest camera at (r, u, b) that has every point p within its slopes: |p.right - r| <= slope (b - p.back),
    // and the same upwards.
    const tall = FILL * Math.tan((this.camera.fov * Math.PI) / 360);
    const wide = tall * this.camera.aspect;
    const most = [-Infinity, -Infinity, -Infinity, -Infinity];
    let [depths, count] = [0, 0];
    for (const point of this.seen.values()) {
      const [r, u, b] = [point.dot(right), point.dot(up), point.dot(back)];
      [r + wide * b, -r + wide * b, u + tall * b, -u + tall * b].forEach((value, side) => (most[side] = Math.max(most[side], value)));
      [depths, count] = [depths + b, count + 1];
    }
    const distance = Math.max((most[0] + most[1]) / (2 * wide), (most[2] + most[3]) / (2 * tall));
    const middle = new THREE.Vector3().addScaledVector(right, (most[0] - most[1]) / 2).addScaledVector(up, (most[2] - most[3]) / 2);
    this.camera.position.copy(middle).addScaledVector(back, distance);
    this.controls.target.copy(middle).addScaledVector(back, Math.min(depths / count, distance - 0.05));
    this.controls.update();
    this.camera.updateMatrixWorld();
    this.touch();
  }

  /** The point in the window above a point in the root's frame; null behind the camera. */
  project(point: THREE.Vector3): { x: number; y: number } | null {
    const seen = point.clone().project(this.camera);
    if (seen.z > 1) return null;
    return { x: ((seen.x + 1) / 2) * this.canvas.clientWidth, y: ((1 - seen.y) / 2) * this.canvas.clientHeight };
  }

  private key(event: KeyboardEvent): void {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target !== this.place) return;
    const around = new THREE.Spherical();
    const turn = (yaw: number, pitch: number, zoom: number) => {
      // Spherical coordinates have y up.
      const arm = this.camera.position.clone().sub(this.controls.target);
      around.setFromCartesianCoords(arm.y, arm.z, arm.x);
      around.theta += yaw;
      around.phi = Math.min(Math.max(around.phi + pitch, 0.02), Math.PI - 0.02);
      around.radius *= zoom;
      const [y, z, x] = new THREE.Vector3().setFromSpherical(around).toArray();
      this.camera.position.copy(this.controls.target).add(new THREE.Vector3(x, y, z));
      this.controls.update();
    };
    const action = {
      ArrowLeft: () => turn(-KEY_TURN, 0, 1),
      ArrowRight: () => turn(KEY_TURN, 0, 1),
      ArrowUp: () => turn(0, -KEY_TURN, 1),
      ArrowDown: () => turn(0, KEY_TURN, 1),
      "+": () => turn(0, 0, 1 / KEY_ZOOM),
      "-": () => turn(0, 0, KEY_ZOOM),
      f: () => this.view("fit"),
    }[event.key];
    if (!action) return;
    event.preventDefault();
    if (event.key !== "f") this.followed = null;
    action();
    this.touch();
  }

  private resize(): void {
    const { clientWidth, clientHeight } = this.place;
    if (clientWidth === 0 || clientHeight === 0) return;
    this.renderer?.setSize(clientWidth, clientHeight, false);
    this.camera.aspect = clientWidth / clientHeight;
    this.camera.updateProjectionMatrix();
    if (this.followed) this.view(this.followed);
    this.touch();
  }

  private draw(): void {
    if (!this.isStale || document.hidden || !this.robot) return;
    this.isStale = false;
    this.beforeDrawing();
    if (!this.renderer) return;
    this.renderer.render(this.scene, this.camera);
    this.drawn += 1;
  }
}
