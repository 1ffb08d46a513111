//! The operator as the live pipeline uses it: single precision, channel-major, so that one frame is a sum of scaled
//! columns over an image that stays in the first-level cache. Allocates nothing per frame.

use super::Operator;

/// `image = sum_c dv[c] * column_c`, f32.
#[derive(Clone, Debug)]
pub struct LiveOperator {
    unknowns: usize,
    channels: usize,
    /// Columns padded to whole vectors, channel after channel.
    columns: Vec<f32>,
    stride: usize,
    arch: pulp::Arch,
}

const PADDING: usize = 16;
/// Channels summed together, to load and store the image less often.
const GROUP: usize = 8;

impl LiveOperator {
    /// Copies an operator, each unknown multiplied by `scale` (polarity and units of the image).
    pub fn new(operator: &Operator, scale: f64) -> Self {
        let (unknowns, channels) = (operator.matrix.nrows(), operator.matrix.ncols());
        let stride = unknowns.next_multiple_of(PADDING);
        let mut columns = vec![0.0; stride * channels];
        for channel in 0..channels {
            let target = &mut columns[channel * stride..][..unknowns];
            let source = operator.matrix.col(channel);
            target.iter_mut().zip(source.iter()).for_each(|(to, from)| *to = (from * scale) as f32);
        }
        Self { unknowns, channels, columns, stride, arch: pulp::Arch::new() }
    }

    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        self.unknowns
    }

    /// Number of channels.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Reconstructs one frame of difference data into `image` (one value an unknown).
    ///
    /// # Panics
    /// If the lengths are not those of the operator: a programming error, checked where frames enter the pipeline.
    pub fn apply(&self, dv: &[f32], image: &mut [f32]) {
        assert_eq!(dv.len(), self.channels, "channels of the frame");
        assert_eq!(image.len(), self.unknowns, "unknowns of the image");
        self.arch.dispatch(|| accumulate(&self.columns, self.stride, dv, image));
    }
}

#[inline(always)]
fn accumulate(columns: &[f32], stride: usize, dv: &[f32], image: &mut [f32]) {
    image.fill(0.0);
    let count = image.len();
    for (group, values) in dv.chunks(GROUP).enumerate() {
        let column = |k: usize| &columns[(group * GROUP + k) * stride..][..count];
        if values.len() == GROUP {
            let (a, b, c, d) = (column(0), column(1), column(2), column(3));
            let (e, f, g, h) = (column(4), column(5), column(6), column(7));
            for (i, pixel) in image.iter_mut().enumerate() {
                *pixel += (a[i] * values[0] + b[i] * values[1] + (c[i] * values[2] + d[i] * values[3]))
                    + (e[i] * values[4] + f[i] * values[5] + (g[i] * values[6] + h[i] * values[7]));
            }
        } else {
            for (k, value) in values.iter().enumerate() {
                image.iter_mut().zip(column(k)).for_each(|(pixel, entry)| *pixel += entry * value);
            }
        }
    }
}
