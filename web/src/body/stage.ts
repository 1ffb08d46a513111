// The view of the robot: camera, light, ground and the labels over it. Draws only what has changed.

import * as THREE from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import type { Robot } from "./robot";

/** Directions from which to look, root's frame: x forward, y left, z up. */
export const VIEWS = { fit: [1, 0.62, 0.5], front: [1, 0, 0.0001], left: [0, 1, 0.0001], back: [-1, 0, 0.0001], above: [0.0001, 0, 1] } as const;
export type ViewName = keyof typeof VIEWS;

/** Share of the view that the robot fills. */
const FILL = 1.15;
/** Turn and zoom of a key press. */
const KEY_TURN = Math.PI / 24;
const KEY_ZOOM = 1.1;

export class Stage {
  readonly camera = new THREE.PerspectiveCamera(35, 1, 0.01, 100);
  readonly controls: OrbitControls;
  readonly canvas: HTMLCanvasElement;
  /** Pictures drawn. */
  drawn = 0;
  /** Called before a picture is drawn. */
  beforeDrawing: () => void = () => {};
  private readonly renderer: THREE.WebGLRenderer;
  private readonly scene = new THREE.Scene();
  private readonly grid = new THREE.Group();
  private readonly light = new THREE.DirectionalLight(0xffffff, 1.9);
  private isStale = true;
  private robot: Robot | null = null;

  constructor(private readonly place: HTMLElement) {
    THREE.Object3D.DEFAULT_UP.set(0, 0, 1);
    this.camera.up.set(0, 0, 1);
    this.renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true });
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.canvas = this.renderer.domElement;
    place.prepend(this.canvas);
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.enableDamping = false;
    this.controls.minDistance = 0.05;
    this.controls.maxDistance = 50;
    this.controls.addEventListener("change", () => this.touch());
    this.light.position.set(2, 1.2, 3);
    const fill = new THREE.DirectionalLight(0xffffff, 0.5);
    fill.position.set(-2, -1.5, 1);
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x8a8f98, 1.5), this.light, fill, this.grid);
    new ResizeObserver(() => this.resize()).observe(place);
    place.addEventListener("keydown", (event) => this.key(event));
    this.resize();
    const loop = () => {
      this.draw();
      requestAnimationFrame(loop);
    };
    requestAnimationFrame(loop);
  }

  begin(robot: Robot): void {
    if (this.robot) this.scene.remove(this.robot.group);
    this.robot = robot;
    this.scene.add(robot.group);
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
    const box = this.robot.box();
    const size = box.getSize(new THREE.Vector3());
    const half = Math.max(1, Math.ceil(1.2 * Math.max(size.x, size.y)));
    const lines = (step: number, colour: string) => {
      const grid = new THREE.GridHelper(2 * half, Math.round((2 * half) / step), colour, colour).rotateX(Math.PI / 2);
      grid.position.z = Math.min(box.min.z, 0) - 1e-3;
      return grid;
    };
    this.grid.add(lines(0.1, minor), lines(0.5, major), new THREE.AxesHelper(0.15));
  }

  /** Looks at the whole robot from one side. */
  view(name: ViewName): void {
    if (!this.robot) return;
    const box = this.robot.box();
    const middle = box.getCenter(new THREE.Vector3());
    const direction = new THREE.Vector3(...VIEWS[name]).normalize();
    // The farthest corner, seen from there, must fit into height and width.
    const basis = new THREE.Matrix4().lookAt(direction, new THREE.Vector3(), this.camera.up);
    const [right, up, back] = [new THREE.Vector3(), new THREE.Vector3(), new THREE.Vector3()];
    basis.extractBasis(right, up, back);
    const tall = Math.tan((this.camera.fov * Math.PI) / 360);
    let distance = 0.1;
    for (let k = 0; k < 8; k += 1) {
      const corner = new THREE.Vector3(k & 1 ? box.max.x : box.min.x, k & 2 ? box.max.y : box.min.y, k & 4 ? box.max.z : box.min.z).sub(middle);
      const near = corner.dot(direction);
      distance = Math.max(distance, near + Math.abs(corner.dot(up)) / tall, near + Math.abs(corner.dot(right)) / (tall * this.camera.aspect));
    }
    this.camera.position.copy(middle).addScaledVector(direction, FILL * distance);
    this.controls.target.copy(middle);
    this.controls.update();
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
    action();
    this.touch();
  }

  private resize(): void {
    const { clientWidth, clientHeight } = this.place;
    if (clientWidth === 0 || clientHeight === 0) return;
    this.renderer.setSize(clientWidth, clientHeight, false);
    this.camera.aspect = clientWidth / clientHeight;
    this.camera.updateProjectionMatrix();
    this.touch();
  }

  private draw(): void {
    if (!this.isStale || document.hidden || !this.robot) return;
    this.isStale = false;
    this.beforeDrawing();
    this.renderer.render(this.scene, this.camera);
    this.drawn += 1;
  }
}
