//! The scene of a body: its links as the URDF file shapes them, and its skins as triangles.

use std::collections::BTreeMap;

use dermis_body::urdf::{Geometry, Shape};
use dermis_body::{Body, Patch, Transform};
use dermis_page::{
    BodyScene, GeometryView, JointView, LinkView, PatchView, Pose, RimView, RunningPatchView, Scene, ShapeView,
    SurfaceView, rings,
};
use dermis_tomo::mesh::{Outline, Point, SheetSpec, Surface};

/// Millimetres per metre.
const MM: f64 = 1e3;
/// Triangles of a flat skin: enough for a smooth rim, and few enough for a body of many skins.
const TRIANGLES: f64 = 500.0;
/// Largest distance between a bent skin and its triangles, metres. Skins are drawn 1 mm above their link.
const CHORD_ERROR_M: f64 = 0.3e-3;
/// Steps along each edge of a rim, which may be bent.
const RIM_STEPS: usize = 12;

/// The scene of a body. `running` has the scenes of the patches that run, by number, and `meshes` the numbers of the
/// meshes that are drawn, by their names in the URDF file.
pub(super) fn body_scene(
    body: &Body,
    sets_joints: bool,
    running: &[Option<Scene>],
    meshes: &BTreeMap<String, usize>,
) -> BodyScene {
    let kinematics = &body.kinematics;
    let urdf = body.urdf.as_ref().map(|(_, urdf)| urdf);
    let shapes = |link: usize| urdf.and_then(|urdf| urdf.links.get(link)).map_or(&[][..], |link| &link.shapes);
    let links = kinematics.link_names().enumerate().map(|(number, name)| LinkView {
        name: name.to_owned(),
        parent: kinematics.parent(number),
        shapes: shapes(number).iter().filter_map(|shape| shape_view(shape, meshes)).collect(),
    });
    let slides = |name: &str| {
        let joint = urdf.and_then(|urdf| urdf.joints.iter().find(|joint| joint.name == name));
        joint.is_some_and(|joint| joint.kind == dermis_body::urdf::JointKind::Prismatic)
    };
    let joints = kinematics.moving_joints().map(|name| JointView {
        name: name.to_owned(),
        unit: if slides(name) { "m" } else { "rad" },
        limits: kinematics.limits(name),
    });
    let patches = body.patches.iter().zip(running);
    BodyScene {
        body: body.name.clone(),
        root: body.root().to_owned(),
        links: links.collect(),
        joints: joints.collect(),
        sets_joints,
        patches: patches.map(|(patch, scene)| patch_view(patch, scene.as_ref())).collect(),
        not_drawn: Vec::new(),
    }
}

/// A transform as the page reads it.
pub(super) fn pose(outer_from_inner: &Transform) -> Pose {
    let ([x, y, z], [qx, qy, qz, qw]) = (outer_from_inner.translation_m, outer_from_inner.quaternion());
    [x, y, z, qx, qy, qz, qw]
}

fn shape_view(shape: &Shape, meshes: &BTreeMap<String, usize>) -> Option<ShapeView> {
    let geometry = match &shape.geometry {
        Geometry::Box { size_m } => GeometryView::Box(*size_m),
        Geometry::Cylinder { radius_m, length_m } => GeometryView::Cylinder([*radius_m, *length_m]),
        Geometry::Sphere { radius_m } => GeometryView::Sphere(*radius_m),
        Geometry::Mesh { filename, scale } => {
            GeometryView::Mesh { address: format!("mesh/{}", meshes.get(filename)?), scale: *scale }
        }
    };
    Some(ShapeView { link_from_shape: pose(&shape.link_from_shape), geometry })
}

fn patch_view(patch: &Patch, scene: Option<&Scene>) -> PatchView {
    PatchView {
        name: patch.name.clone(),
        skin: patch.skin.name.clone(),
        link: patch.link,
        link_from_patch: pose(&patch.link_from_patch),
        surface: surface_view(&patch.skin.outline(), &patch.surface()),
        running: scene.map(|scene| RunningPatchView {
            page: format!("patch/{}/", patch.name),
            is_twin: scene.is_twin,
            grid: scene.grid,
            outline_mm: scene.outline_mm.clone(),
            image_quantity: scene.image_quantity.clone(),
            range_hint: scene.range_hint,
            press: scene.press,
        }),
    }
}

/// A sheet on its surface. A sheet that cannot be meshed has rims only.
fn surface_view(outline: &Outline, surface: &Surface) -> SurfaceView {
    let in_mm = |point: [f64; 3]| point.map(|m| (MM * m) as f32);
    let along = |ring: Vec<Point>| {
        let edges = (0..ring.len()).map(|k| (ring[k], ring[(k + 1) % ring.len()]));
        let points = edges.flat_map(|(a, b)| {
            (0..RIM_STEPS).map(move |step| {
                let share = step as f64 / RIM_STEPS as f64;
                [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])]
            })
        });
        let mut rim = RimView::default();
        for sheet_m in points {
            rim.positions_mm.extend(in_mm(surface.point_m(sheet_m)));
            rim.normals.extend(surface.normal(sheet_m).map(|part| part as f32));
        }
        rim
    };
    let mut view = SurfaceView { rims: rings(outline).into_iter().map(along).collect(), ..SurfaceView::default() };
    // An equilateral triangle with edge h covers sqrt(3)/4 h^2. Its edge as a chord of a circle of radius r is off by
    // h^2 / (8 r).
    let flat_m = (outline.area_m2() / TRIANGLES / 0.433).sqrt();
    let size_m = match *surface {
        Surface::Flat => flat_m,
        Surface::Cylinder { radius_m } => flat_m.min((8.0 * radius_m * CHORD_ERROR_M).sqrt()),
    };
    let Ok((sheet, _)) = SheetSpec::new(outline.clone(), Vec::new(), size_m).build(&[]) else { return view };
    for &[x, y, _] in sheet.mesh.nodes() {
        view.positions_mm.extend(in_mm(surface.point_m([x, y])));
        view.normals.extend(surface.normal([x, y]).map(|part| part as f32));
        view.sheet_mm.extend([x, y].map(|m| (MM * m) as f32));
    }
    let corner = |node: u32| sheet.mesh.nodes()[node as usize];
    for element in sheet.mesh.elements() {
        let &[a, b, c] = element else { continue };
        let [[ax, ay, _], [bx, by, _], [cx, cy, _]] = [a, b, c].map(corner);
        let is_left = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) > 0.0;
        view.triangles.extend(if is_left { [a, b, c] } else { [a, c, b] });
    }
    view
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bent_sheet_is_triangles_on_its_cylinder_seen_from_outside() {
        let outline = Outline::Rectangle { width_m: 0.2, height_m: 0.1 };
        let view = surface_view(&outline, &Surface::Cylinder { radius_m: 0.05 });
        let point = |k: u32| [0, 1, 2].map(|axis| f64::from(view.positions_mm[3 * k as usize + axis]));
        assert!(view.triangles.len() > 3 * 300 && view.positions_mm.len() == view.normals.len());
        for triangle in view.triangles.chunks_exact(3) {
            let [a, b, c] = [point(triangle[0]), point(triangle[1]), point(triangle[2])];
            let [u, v] = [b, c].map(|p| [p[0] - a[0], p[1] - a[1], p[2] - a[2]]);
            let normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
            // The axis runs along y, one radius below.
            let middle = [0, 2].map(|axis| (a[axis] + b[axis] + c[axis]) / 3.0);
            let outwards = [middle[0], middle[1] + 50.0];
            assert!(normal[0] * outwards[0] + normal[2] * outwards[1] > 0.0, "{a:?} {b:?} {c:?}");
            assert!(50.0 - outwards[0].hypot(outwards[1]) < MM * CHORD_ERROR_M, "{outwards:?}");
        }
    }
}
