//! The target element size at every point: small at electrodes and lines, growing with the distance from them.

use super::super::plane::{self, Point, distance, sides, to_segment};
use super::features::{Border, Features, Sizes};

/// Growth of the element size per unit distance from an electrode.
const GRADING: f64 = 0.35;
/// Number of edges along an interior line.
const LINE_EDGES: f64 = 10.0;
/// Edge length at the ends of a line, where the fields of a slit are singular, as a share of the line.
const LINE_END: f64 = 3e-3;

/// A region where elements must be small.
struct Source {
    segments: Vec<[Point; 2]>,
    low: Point,
    high: Point,
    size: f64,
}

impl Source {
    fn new(segments: Vec<[Point; 2]>, size: f64) -> Self {
        let ends: Vec<Point> = segments.iter().flatten().copied().collect();
        let (low, high) = plane::bounds(&ends);
        Self { segments, low, high, size }
    }

    fn length(&self) -> f64 {
        self.segments.iter().map(|[a, b]| distance(*a, *b)).sum()
    }
}

/// The target element size at every point.
pub struct SizeField {
    pub base: f64,
    sources: Vec<Source>,
}

impl SizeField {
    pub fn at(&self, p: Point) -> f64 {
        let mut size = self.base;
        for source in &self.sources {
            let beside = |axis: usize| (source.low[axis] - p[axis]).max(p[axis] - source.high[axis]).max(0.0);
            // Skip sources too far away to reduce the size. Squares, since this runs for every point and electrode.
            let (reach, [x, y]) = ((size - source.size) / GRADING, [beside(0), beside(1)]);
            if reach <= 0.0 || x * x + y * y >= reach * reach {
                continue;
            }
            for [a, b] in &source.segments {
                size = size.min(source.size + GRADING * to_segment(p, *a, *b).0);
            }
        }
        size
    }

    pub fn smallest(&self) -> f64 {
        self.sources.iter().map(|source| source.size).fold(self.base, f64::min)
    }

    /// Boxes outside which all target sizes are at least `size`.
    pub fn finer_than(&self, size: f64) -> impl Iterator<Item = (Point, Point)> + '_ {
        self.sources.iter().filter(move |source| source.size < size).map(move |source| {
            let reach = (size - source.size) / GRADING;
            ([source.low[0] - reach, source.low[1] - reach], [source.high[0] + reach, source.high[1] + reach])
        })
    }

    /// Approximate number of elements for this field: the integral of `4 / (sqrt(3) h^2)`.
    pub fn expected_elements(&self, area: f64) -> f64 {
        let near = |source: &Source| {
            let ratio = (self.base / source.size).max(1.0);
            2.0 * source.length() / (GRADING * source.size) * (1.0 - 1.0 / ratio)
                + std::f64::consts::TAU * ratio.ln() / (GRADING * GRADING)
        };
        2.31 * (area / (self.base * self.base) + self.sources.iter().map(near).sum::<f64>())
    }
}

pub fn size_field(border: &Border, features: &Features, sizes: Sizes) -> SizeField {
    let electrode = sizes.electrode.min(sizes.base);
    let mut sources = Vec::new();
    for span in &features.spans {
        let length = span.end - span.start;
        let pieces = match border {
            Border::Circle { radius } => (length / radius / 0.1).ceil().max(1.0) as usize,
            Border::Polygon { vertices, .. } => 4 * vertices.len(),
        };
        let at = |k: usize| border.at(span.start + length * k as f64 / pieces as f64);
        let segments = (0..pieces).map(|k| [at(k), at(k + 1)]).collect();
        sources.push(Source::new(segments, electrode.min(length / sizes.least_segments.max(1) as f64)));
    }
    for pad in &features.pads {
        let shortest = sides(pad).map(|[a, b]| distance(a, b)).fold(f64::INFINITY, f64::min);
        let feature = if pad.len() == 4 { shortest / 2.0 } else { shortest };
        sources.push(Source::new(sides(pad).collect(), electrode.min(feature)));
    }
    let rim_points = features.rim_points.iter().map(|&s| border.at(s));
    sources.extend(features.points.iter().copied().chain(rim_points).map(|p| Source::new(vec![[p, p]], electrode)));
    for &[a, b] in &features.lines {
        let length = distance(a, b);
        sources.push(Source::new(vec![[a, b]], length / LINE_EDGES));
        sources.extend([a, b].map(|end| Source::new(vec![[end, end]], LINE_END * length)));
    }
    SizeField { base: sizes.base, sources }
}
