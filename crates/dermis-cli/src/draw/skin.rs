//! A sheet skin drawn to scale as its model sees it: elements, rim, electrodes numbered from 1, axes in millimetres
//! and a scale bar. x points right and y up, seen from the side that is touched.

use dermis_tomo::mesh::{Contact, ElectrodedMesh, Point, distance};

use super::axis::{nice_at_least, nice_at_most, tick_label};
use super::picture::{Anchor, Colour, INK, Item, Picture, PixelPoint, Polyline, Shape, Stroke, Text, WHITE};
use super::text::{CAPITAL, width};

const MESH: Colour = Colour(186, 198, 210);
const COPPER: Colour = Colour(196, 98, 34);

/// Settings of a drawing.
pub struct SkinDrawing<'a> {
    /// Mesh and electrodes of a flat sheet.
    pub body: &'a ElectrodedMesh,
    /// Title of the picture.
    pub title: &'a str,
    /// Width of the picture, pixels.
    pub width_px: u32,
    /// Draw the elements.
    pub mesh: bool,
}

/// Layout in pixels.
struct Layout {
    /// Scale of lines and letters: 1 in a picture 1000 pixels wide.
    unit: f64,
    width: f64,
    height: f64,
    /// Left, top, right and bottom of the frame.
    frame: [f64; 4],
    /// Centre of the skin, in metres and in pixels.
    centre_m: Point,
    centre: PixelPoint,
    pixels_per_m: f64,
    /// Width of the skin, metres.
    width_m: f64,
}

impl SkinDrawing<'_> {
    /// The picture.
    pub fn picture(&self) -> Picture {
        let layout = Layout::of(self.body, self.width_px);
        let mut items = Vec::new();
        if self.mesh {
            items.push(self.elements(&layout).into());
        }
        items.push(self.rim(&layout).into());
        items.push(self.electrodes(&layout).into());
        items.extend(self.numbers(&layout).into_iter().map(Item::Text));
        items.extend(axes(&layout));
        items.extend(scale_bar(&layout));
        let title = self.title.to_string();
        Picture { title, width_px: self.width_px, height_px: layout.height as u32, items }
    }

    fn elements(&self, layout: &Layout) -> Shape {
        let mesh = &self.body.mesh;
        let sides = |cell: &[u32]| [[cell[0], cell[1]], [cell[1], cell[2]], [cell[2], cell[0]]];
        let mut edges: Vec<[u32; 2]> = mesh.elements().flat_map(sides).map(|[a, b]| [a.min(b), a.max(b)]).collect();
        edges.sort_unstable();
        edges.dedup();
        let lines = edges.iter().map(|edge| Polyline::open(edge.map(|node| self.node(layout, node)))).collect();
        Shape::stroked("mesh", lines, MESH, 0.8 * layout.unit)
    }

    fn rim(&self, layout: &Layout) -> Shape {
        let faces = self.body.mesh.boundary_faces();
        let line = |face: &[u32]| Polyline::open(face.iter().map(|&n| self.node(layout, n)).collect::<Vec<_>>());
        Shape::stroked("outline", faces.iter().map(|(face, _)| line(face)).collect(), INK, 2.5 * layout.unit)
    }

    fn electrodes(&self, layout: &Layout) -> Shape {
        let mut lines = Vec::new();
        for electrode in &self.body.electrodes {
            match &electrode.contact {
                Contact::Faces(faces) => lines.extend(faces.iter().map(|face| self.band(layout, face))),
                Contact::Area(elements) => lines.extend(elements.iter().map(|&element| {
                    let corners = self.body.mesh.element(element as usize);
                    anticlockwise(corners.iter().map(|&node| self.node(layout, node)).collect())
                })),
                Contact::Point(node) => lines.push(Polyline::disc(self.node(layout, *node), 7.0 * layout.unit)),
            }
        }
        let stroke = Some(Stroke { colour: COPPER, width: 0.8 * layout.unit });
        Shape { class: "electrodes", lines, fill: Some(COPPER), stroke, crisp: false }
    }

    /// A rim electrode as a band outside the skin; a line electrode inside the skin as a band along it.
    fn band(&self, layout: &Layout, face: &[u32]) -> Polyline {
        let [a, b] = [face[0], face[1]].map(|node| self.node(layout, node));
        let [x, y] = self.outward(layout, face).map(|component| component * 10.0 * layout.unit);
        anticlockwise(vec![a, b, [b[0] + x, b[1] + y], [a[0] + x, a[1] + y]])
    }

    /// Unit normal of a face in pixels, pointing away from its element (for lines inside the skin, away from the
    /// skin's centre).
    fn outward(&self, layout: &Layout, face: &[u32]) -> PixelPoint {
        let [a, b] = [face[0], face[1]].map(|node| self.node(layout, node));
        let middle = mean(&[a, b]);
        let mut owners = self.body.mesh.elements().filter(|cell| face.iter().all(|node| cell.contains(node)));
        let inside = match (owners.next(), owners.next()) {
            (Some(cell), None) => mean(&[cell[0], cell[1], cell[2]].map(|node| self.node(layout, node))),
            _ => layout.centre,
        };
        let normal = unit([b[1] - a[1], a[0] - b[0]]);
        let away = normal[0] * (middle[0] - inside[0]) + normal[1] * (middle[1] - inside[1]);
        if away < 0.0 { normal.map(|component| -component) } else { normal }
    }

    fn numbers(&self, layout: &Layout) -> Vec<Text> {
        let centres: Vec<PixelPoint> = self.body.electrodes.iter().map(|e| self.centre(layout, &e.contact)).collect();
        let height = (0.6 * nearest_distance(&centres)).clamp(7.0 * layout.unit, 18.0 * layout.unit);
        let electrodes = self.body.electrodes.iter().enumerate();
        electrodes.map(|(index, electrode)| self.number(layout, &electrode.contact, index + 1, height)).collect()
    }

    /// The number of an electrode, with digits of the given height: outside a rim electrode, on a pad if it is large
    /// enough, or else next to the pad on the side of the skin's centre.
    fn number(&self, layout: &Layout, contact: &Contact, number: usize, height: f64) -> Text {
        let centre = self.centre(layout, contact);
        let (words, size) = (number.to_string(), height / CAPITAL);
        let wide = width(&words, size);
        let reach =
            |direction: PixelPoint, gap: f64| gap + 0.5 * (direction[0].abs() * wide + direction[1].abs() * height);
        let beside = |direction: PixelPoint, gap: f64| {
            let reach = reach(direction, gap);
            let at = [centre[0] + direction[0] * reach, centre[1] + direction[1] * reach];
            // A white rim keeps digits legible over the mesh.
            Text { class: "number", halo: 2.5 * layout.unit, ..Text::new(words.clone(), size, at) }
        };
        let [right, down] = [layout.centre[0] - centre[0], layout.centre[1] - centre[1]];
        let inward = unit([right, down]);
        // Near the centre, move numbers of small electrodes outward, or they would overlap.
        let aside = |gap: f64| {
            let is_near = right.hypot(down) < 2.0 * reach(inward, gap) + wide;
            beside(if is_near { inward.map(|component| -component) } else { inward }, gap)
        };
        match contact {
            Contact::Faces(faces) => {
                let normals: Vec<PixelPoint> = faces.iter().map(|face| self.outward(layout, face)).collect();
                beside(unit(mean(&normals)), 17.0 * layout.unit)
            }
            Contact::Area(elements) => {
                let [pad_width, pad_height] = self.extent(layout, elements);
                if wide < 0.8 * pad_width && height < 0.7 * pad_height {
                    Text { class: "number", colour: WHITE, ..Text::new(words, size, centre) }
                } else {
                    aside(0.5 * pad_width.max(pad_height) + 5.0 * layout.unit)
                }
            }
            Contact::Point(_) => aside(13.0 * layout.unit),
        }
    }

    fn centre(&self, layout: &Layout, contact: &Contact) -> PixelPoint {
        let nodes: Vec<u32> = match contact {
            Contact::Faces(faces) => faces.concat(),
            Contact::Area(elements) => {
                elements.iter().flat_map(|&e| self.body.mesh.element(e as usize)).copied().collect()
            }
            Contact::Point(node) => vec![*node],
        };
        let points: Vec<PixelPoint> = nodes.iter().map(|&node| self.node(layout, node)).collect();
        let (low, high) = bounds(&points);
        // The centre of a curved or bent rim electrode isn't that of its bounds, so use the mean of its nodes.
        if matches!(contact, Contact::Area(_)) { mean(&[low, high]) } else { mean(&points) }
    }

    fn extent(&self, layout: &Layout, elements: &[u32]) -> PixelPoint {
        let nodes = elements.iter().flat_map(|&element| self.body.mesh.element(element as usize));
        let (low, high) = bounds(&nodes.map(|&node| self.node(layout, node)).collect::<Vec<_>>());
        [high[0] - low[0], high[1] - low[1]]
    }

    fn node(&self, layout: &Layout, node: u32) -> PixelPoint {
        let [x, y, _] = self.body.mesh.nodes()[node as usize];
        layout.place([x, y])
    }
}

impl Layout {
    fn of(body: &ElectrodedMesh, width_px: u32) -> Self {
        let (low, high) = body.mesh.bounds();
        let [width_m, height_m] = [high[0] - low[0], high[1] - low[1]];
        let width = f64::from(width_px);
        // Smaller letters would be illegible.
        let unit = (width / 1000.0).max(0.5);
        let (left, right, top, bottom, pad) = (90.0 * unit, 30.0 * unit, 25.0 * unit, 100.0 * unit, 60.0 * unit);
        // A skin much taller than wide is drawn narrower, to limit the picture's height.
        let room = [width - left - right - 2.0 * pad, 2.0 * width];
        let pixels_per_m = (room[0] / width_m).min(room[1] / height_m);
        let frame = [left, top, width - right, top + 2.0 * pad + height_m * pixels_per_m];
        let centre = [0.5 * (frame[0] + frame[2]), 0.5 * (frame[1] + frame[3])];
        let centre_m = [0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])];
        let height = (frame[3] + bottom).ceil();
        Self { unit, width, height, frame, centre_m, centre, pixels_per_m, width_m }
    }

    fn place(&self, [x, y]: Point) -> PixelPoint {
        let [centre_x, centre_y] = self.centre_m;
        [self.centre[0] + (x - centre_x) * self.pixels_per_m, self.centre[1] - (y - centre_y) * self.pixels_per_m]
    }
}

/// Frame, ticks with their values, and axis labels.
fn axes(layout: &Layout) -> Vec<Item> {
    let [left, top, right, bottom] = layout.frame;
    let unit = layout.unit;
    let step_mm = nice_at_least(90.0 * unit / layout.pixels_per_m * 1e3);
    let (size, name_size) = (20.0 * unit, 22.0 * unit);
    let mut lines = vec![Polyline::rectangle([left, top], [right, bottom])];
    let mut texts = Vec::new();
    for value_mm in ticks(layout, 0, step_mm) {
        let [x, _] = layout.place([value_mm * 1e-3, 0.0]);
        lines.push(Polyline::open([[x, bottom], [x, bottom + 7.0 * unit]]));
        texts.push(Text::new(tick_label(value_mm, step_mm), size, [x, bottom + 24.0 * unit]));
    }
    for value_mm in ticks(layout, 1, step_mm) {
        let [_, y] = layout.place([0.0, value_mm * 1e-3]);
        lines.push(Polyline::open([[left - 7.0 * unit, y], [left, y]]));
        let at = [left - 13.0 * unit, y];
        texts.push(Text { anchor: Anchor::End, ..Text::new(tick_label(value_mm, step_mm), size, at) });
    }
    texts.push(Text::new("x (mm)", name_size, [layout.centre[0], bottom + 62.0 * unit]));
    texts.push(Text { upward: true, ..Text::new("y (mm)", name_size, [left - 74.0 * unit, layout.centre[1]]) });
    let labels = texts.into_iter().map(|text| Text { class: "label", ..text }.into());
    std::iter::once(Shape::stroked("axes", lines, INK, 1.2 * unit).into()).chain(labels).collect()
}

/// Multiples of `step_mm` inside the frame along an axis.
fn ticks(layout: &Layout, axis: usize, step_mm: f64) -> impl Iterator<Item = f64> {
    let half_mm = 0.5e3 * (layout.frame[axis + 2] - layout.frame[axis]) / layout.pixels_per_m;
    let centre_mm = 1e3 * layout.centre_m[axis];
    let first = ((centre_mm - half_mm) / step_mm).ceil() as i64;
    let last = ((centre_mm + half_mm) / step_mm).floor() as i64;
    (first..=last).map(move |multiple| multiple as f64 * step_mm)
}

fn scale_bar(layout: &Layout) -> [Item; 2] {
    let unit = layout.unit;
    let length_mm = nice_at_most(0.25e3 * layout.width_m);
    let length = length_mm * 1e-3 * layout.pixels_per_m;
    let (right, y) = (layout.width - 30.0 * unit, layout.frame[3] + 62.0 * unit);
    let left = right - length;
    let half = 6.0 * unit;
    let words = format!("{} mm", tick_label(length_mm, length_mm));
    let text = Text { anchor: Anchor::End, ..Text::new(words, 22.0 * unit, [left - 14.0 * unit, y]) };
    let mut lines = vec![Polyline::open([[left, y], [right, y]])];
    lines.extend([left, right].map(|x| Polyline::open([[x, y - half], [x, y + half]])));
    [Shape::stroked("scale-bar", lines, INK, 2.2 * unit).into(), text.into()]
}

/// An area with its corners in a consistent direction, so that overlapping areas don't cancel.
fn anticlockwise(mut corners: Vec<PixelPoint>) -> Polyline {
    let next = corners.iter().cycle().skip(1);
    let area: f64 = corners.iter().zip(next).map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum();
    if area < 0.0 {
        corners.reverse();
    }
    Polyline::closed(corners)
}

fn mean(points: &[PixelPoint]) -> PixelPoint {
    let count = points.len().max(1) as f64;
    [0, 1].map(|axis| points.iter().map(|point| point[axis]).sum::<f64>() / count)
}

/// The direction of a vector; up for a zero vector.
fn unit([x, y]: PixelPoint) -> PixelPoint {
    let length = x.hypot(y);
    if length > 1e-9 { [x / length, y / length] } else { [0.0, -1.0] }
}

fn bounds(points: &[PixelPoint]) -> (PixelPoint, PixelPoint) {
    let most = |axis: usize, start: f64, pick: fn(f64, f64) -> f64| points.iter().map(|p| p[axis]).fold(start, pick);
    let low = [0, 1].map(|axis| most(axis, f64::INFINITY, f64::min));
    (low, [0, 1].map(|axis| most(axis, f64::NEG_INFINITY, f64::max)))
}

fn nearest_distance(points: &[PixelPoint]) -> f64 {
    let pairs = points.iter().enumerate().flat_map(|(index, a)| points[..index].iter().map(move |b| (a, b)));
    pairs.map(|(a, b)| distance(*a, *b)).fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dermis_skin::{BUILTIN_NAMES, Skin};

    #[test]
    fn every_electrode_of_every_skin_has_a_number_inside_the_picture() {
        for name in BUILTIN_NAMES {
            let body = Skin::open(name).unwrap().body_with_elements(400).unwrap().mesh;
            let picture = SkinDrawing { body: &body, title: name, width_px: 600, mesh: false }.picture();
            let numbers: Vec<&Text> = picture.texts().filter(|text| text.class == "number").collect();
            assert_eq!(numbers.len(), body.electrodes.len(), "{name}");
            assert!(picture.shapes().all(|shape| shape.class != "mesh"));
            let (width, height) = (f64::from(picture.width_px), f64::from(picture.height_px));
            for [x, y] in picture.shapes().flat_map(|s| &s.lines).flat_map(|line| &line.points) {
                assert!((0.0..=width).contains(x) && (0.0..=height).contains(y), "{name}: {x}, {y}");
            }
            for text in picture.texts().filter(|text| !text.upward) {
                let [left, base] = text.origin();
                let is_inside = left >= 0.0 && left + text.width() <= width && base <= height && base - text.size > 0.0;
                assert!(is_inside, "{name}: {text:?}");
            }
        }
    }

    #[test]
    fn numbers_do_not_overlap() {
        for name in ["piezo-disc", "piezo-square", "healing-square"] {
            let body = Skin::open(name).unwrap().body_with_elements(400).unwrap().mesh;
            let picture = SkinDrawing { body: &body, title: name, width_px: 520, mesh: false }.picture();
            let numbers: Vec<&Text> = picture.texts().filter(|text| text.class == "number").collect();
            for (index, a) in numbers.iter().enumerate() {
                for b in &numbers[..index] {
                    let apart = [(a.at[0] - b.at[0]).abs(), (a.at[1] - b.at[1]).abs()];
                    let is_clear = apart[0] > 0.5 * (a.width() + b.width()) || apart[1] > CAPITAL * a.size;
                    assert!(is_clear, "{name}: {} and {}", a.words, b.words);
                }
            }
        }
    }

    #[test]
    fn y_points_up_and_rim_numbers_are_outside() {
        let body = Skin::open("golfball-tank").unwrap().body_with_elements(400).unwrap().mesh;
        let drawing = SkinDrawing { body: &body, title: "", width_px: 1000, mesh: true };
        let layout = Layout::of(&body, 1000);
        // Electrode 1 lies on +x, electrode 5 on +y.
        let place = |electrode: usize| drawing.number(&layout, &body.electrodes[electrode].contact, 8, 18.0).at;
        let radius = 0.15 * layout.pixels_per_m;
        assert!(place(0)[0] > layout.centre[0] + radius && (place(0)[1] - layout.centre[1]).abs() < 1.0);
        assert!(place(4)[1] < layout.centre[1] - radius && (place(4)[0] - layout.centre[0]).abs() < 1.0);
    }
}
