//! Meshes of a robot's links, as its page fetches them.

use std::collections::{BTreeMap, BTreeSet};

use axum::body::Bytes;
use dermis_body::urdf::Geometry;
use dermis_body::{Body, read_triangles};

/// Most corners on one page: a million triangles, more than the detailed models of arms in use.
const MOST_CORNERS: usize = 3_000_000;

/// The meshes of a robot.
#[derive(Debug, Default)]
pub(super) struct Meshes {
    /// Number of each mesh that is drawn, by its name in the URDF file.
    pub shown: BTreeMap<String, usize>,
    /// Their corners by number: x, y and z as f32, little-endian.
    pub meshes: Vec<Bytes>,
    /// Reasons why others are not drawn.
    pub not_drawn: Vec<String>,
}

impl Meshes {
    /// Reads the meshes of a body.
    pub fn of(body: &Body) -> Self {
        let shapes = body.urdf.iter().flat_map(|(_, urdf)| urdf.links.iter().flat_map(|link| &link.shapes));
        let names: BTreeSet<&str> = shapes
            .filter_map(|shape| match &shape.geometry {
                Geometry::Mesh { filename, .. } => Some(filename.as_str()),
                _ => None,
            })
            .collect();
        let (mut all, mut corners_left) = (Self::default(), MOST_CORNERS);
        for name in names {
            let file = match body.meshes.get(name) {
                Some(Ok(file)) => file,
                // Reported when the body was read.
                unread => {
                    let reason = unread.and_then(|unread| unread.as_ref().err()).map_or("not found", String::as_str);
                    all.not_drawn.push(format!("{name} is not drawn: {reason}"));
                    continue;
                }
            };
            let read = read_triangles(file).and_then(|corners| match corners_left.checked_sub(corners.len()) {
                Some(left) => Ok((corners, left)),
                None => Err(format!("more than {} triangles", MOST_CORNERS / 3)),
            });
            match read {
                Ok((corners, left)) => {
                    corners_left = left;
                    all.shown.insert(name.to_owned(), all.meshes.len());
                    all.meshes.push(corners.iter().flatten().flat_map(|number| number.to_le_bytes()).collect());
                }
                Err(reason) => {
                    let reason = format!("{name} is not drawn: {reason}");
                    tracing::warn!("{reason}");
                    all.not_drawn.push(reason);
                }
            }
        }
        all
    }
}
