// The robot in space: links with the shapes of the URDF file, carrying their skins. The server computes the poses of
// the links, so that only one program knows the kinematics.

import * as THREE from "three";
import type { BodyScene, BodyState, Pose, Shape, Vector } from "./protocol";
import { type Look, Skin3d } from "./skin3d";

/** Sides of a drawn circle: up to a radius of 0.3 m it deviates by less than a skin's height above its link. */
const SIDES = 64;
/** Edges sharper than this are drawn as lines, degrees. */
const EDGE_DEG = 30;

function put(object: THREE.Object3D, [x, y, z, ...turn]: Pose): void {
  object.position.set(x, y, z);
  object.quaternion.set(...turn);
}

/** Fetches a mesh into `geometry`, then calls `loaded`. */
async function load(geometry: THREE.BufferGeometry, address: string, [x, y, z]: Vector, loaded: () => void): Promise<void> {
  const answer = await fetch(address);
  if (!answer.ok) return;
  geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(await answer.arrayBuffer()), 3));
  geometry.scale(x, y, z);
  geometry.computeVertexNormals();
  geometry.computeBoundingSphere();
  geometry.computeBoundingBox();
  loaded();
}

function geometryOf({ geometry }: Shape, loaded: () => void): THREE.BufferGeometry {
  if ("mesh" in geometry) {
    const empty = new THREE.BufferGeometry();
    void load(empty, geometry.mesh.address, geometry.mesh.scale, loaded);
    return empty;
  }
  if ("box" in geometry) return new THREE.BoxGeometry(...geometry.box);
  // The axis of a cylinder is y in three, z in URDF.
  if ("cylinder" in geometry) return new THREE.CylinderGeometry(geometry.cylinder[0], geometry.cylinder[0], geometry.cylinder[1], SIDES).rotateX(Math.PI / 2);
  return new THREE.SphereGeometry(geometry.sphere, SIDES, SIDES / 2);
}

export class Robot {
  readonly group = new THREE.Group();
  readonly skins: Skin3d[];
  readonly links: THREE.Group[];
  /** Called when a mesh has been fetched. */
  loaded: () => void = () => {};
  /** Meshes of the links, for ray casting. */
  readonly solids: THREE.Mesh[] = [];
  private readonly known = new THREE.MeshStandardMaterial({ roughness: 0.75, metalness: 0.05, side: THREE.DoubleSide, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 });
  private readonly unknown = new THREE.MeshStandardMaterial({ roughness: 0.75, transparent: true, opacity: 0.3, side: THREE.DoubleSide, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 });
  private readonly edges = new THREE.LineBasicMaterial({ transparent: true, opacity: 0.35 });
  private readonly solidsOf: THREE.Mesh[][];

  constructor(scene: BodyScene) {
    this.links = scene.links.map(() => new THREE.Group());
    this.solidsOf = scene.links.map(({ shapes }, index) =>
      shapes.map((shape) => {
        const solid = new THREE.Mesh(geometryOf(shape, () => this.loaded()), this.known);
        put(solid, shape.link_from_shape);
        solid.castShadow = true;
        if (!("mesh" in shape.geometry)) solid.add(new THREE.LineSegments(new THREE.EdgesGeometry(solid.geometry, EDGE_DEG), this.edges));
        this.links[index].add(solid);
        this.solids.push(solid);
        return solid;
      }),
    );
    this.skins = scene.patches.map((patch, number) => {
      const skin = new Skin3d(number, patch);
      this.links[patch.link].add(skin.group);
      return skin;
    });
    this.group.add(...this.links);
  }

  /** Colours of the links, by theme. */
  paint(link: string, edge: string): void {
    this.known.color.set(link);
    this.unknown.color.set(link);
    this.edges.color.set(edge);
  }

  show(state: BodyState): void {
    state.links.forEach(({ root_from_link, is_known }, index) => {
      const link = this.links[index];
      link.visible = root_from_link !== null;
      if (root_from_link) put(link, root_from_link);
      for (const solid of this.solidsOf[index]) solid.material = is_known ? this.known : this.unknown;
    });
    state.patches.forEach((patch, number) => {
      const skin = this.skins[number];
      const look: Look = patch.state === "running" ? "live" : patch.state;
      skin.look(look, patch.guard?.verdict ?? null, state.links[skin.patch.link].is_known);
      skin.show(patch.touches);
    });
    this.group.updateMatrixWorld(true);
  }

  /** Corners of boxes around links and skins, in the root's frame. */
  corners(): THREE.Vector3[] {
    return [...this.solids, ...this.skins.map(({ mesh }) => mesh)].flatMap(({ geometry, matrixWorld }) => {
      if (!geometry.hasAttribute("position")) return [];
      if (!geometry.boundingBox) geometry.computeBoundingBox();
      const { min, max } = geometry.boundingBox!;
      return Array.from({ length: 8 }, (_, k) => new THREE.Vector3(k & 1 ? max.x : min.x, k & 2 ? max.y : min.y, k & 4 ? max.z : min.z).applyMatrix4(matrixWorld));
    });
  }
}
