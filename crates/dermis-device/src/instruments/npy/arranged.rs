//! Reorders elements to row-major while they are read, so the array isn't in memory twice.

use super::element::Element;

/// Elements of an array in row-major order, filled as they arrive.
pub(in crate::instruments) struct Arranged {
    values: Vec<f64>,
    /// `None` if the elements already arrive in row-major order.
    place: Option<Place>,
    part: Vec<f64>,
}

/// Position of the next element of a column-major array.
struct Place {
    shape: Vec<usize>,
    /// Stride along each dimension, in elements.
    strides: Vec<usize>,
    index: Vec<usize>,
    at: usize,
}

impl Arranged {
    /// For an array of `count` elements, the product of its dimensions.
    pub(in crate::instruments) fn new(shape: &[usize], count: usize, is_column_major: bool) -> Self {
        // Vectors have the same layout in both orders.
        let is_vector = shape.iter().filter(|length| **length > 1).count() <= 1;
        if !is_column_major || is_vector || count == 0 {
            return Self { values: Vec::with_capacity(count), place: None, part: Vec::new() };
        }
        let mut strides = vec![1; shape.len()];
        for axis in (0..shape.len() - 1).rev() {
            strides[axis] = strides[axis + 1] * shape[axis + 1];
        }
        let place = Place { shape: shape.to_vec(), strides, index: vec![0; shape.len()], at: 0 };
        Self { values: vec![0.0; count], place: Some(place), part: Vec::new() }
    }

    /// Appends elements. `imaginary` receives the imaginary parts of complex ones.
    pub(in crate::instruments) fn take(&mut self, element: Element, bytes: &[u8], imaginary: Option<&mut Self>) {
        let Some(place) = &mut self.place else {
            let mut none = Vec::new();
            let second = imaginary.map_or(&mut none, |imaginary| &mut imaginary.values);
            element.decode(bytes, &mut self.values, second);
            return;
        };
        self.part.clear();
        let mut second = Vec::new();
        element.decode(bytes, &mut self.part, &mut second);
        place.put(&self.part, &mut self.values);
        if let Some(Self { values, place: Some(place), .. }) = imaginary {
            place.put(&second, values);
        }
    }

    /// All elements, row-major.
    pub(in crate::instruments) fn into_values(self) -> Vec<f64> {
        self.values
    }
}

impl Place {
    fn put(&mut self, elements: &[f64], values: &mut [f64]) {
        for element in elements {
            if let Some(value) = values.get_mut(self.at) {
                *value = *element;
            }
            for axis in 0..self.shape.len() {
                self.index[axis] += 1;
                self.at += self.strides[axis];
                if self.index[axis] < self.shape[axis] {
                    break;
                }
                self.at -= self.strides[axis] * self.shape[axis];
                self.index[axis] = 0;
            }
        }
    }
}
