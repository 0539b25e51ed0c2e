//! Sets of pixels.

/// A set of pixels of an image, kept for a window of it.
///
/// What the set holds at the image's edge it holds beyond: an area that touches the edge offers no
/// way out there.
#[derive(Clone)]
pub struct Patch {
    /// Width and height of the image.
    image: [i64; 2],
    /// First column and row of the window.
    low: [i64; 2],
    /// Columns and rows of the window.
    size: [i64; 2],
    set: Vec<bool>,
}

impl Patch {
    /// The connected sets of the pixels that are not 0, touching at a corner or along a side, in
    /// the order of their first pixels.
    pub fn connected(width: usize, height: usize, pixels: &[u8]) -> Vec<Self> {
        let image = [width as i64, height as i64];
        let mut rest = Self {
            image,
            low: [0, 0],
            size: image,
            set: pixels.iter().map(|p| *p != 0).collect(),
        };
        let mut found = Vec::new();
        for index in 0..rest.set.len() {
            if rest.set[index] {
                let patch = rest.reached(rest.pixel(index), |_| true);
                rest.remove(&patch);
                found.push(patch.tight());
            }
        }
        found
    }

    /// The pixels of the set that can be reached from `seed` through such pixels, all of them with
    /// `keep`.
    pub fn reached(&self, seed: [i64; 2], keep: impl Fn([i64; 2]) -> bool) -> Self {
        let mut found = self.empty();
        let mut open = Vec::new();
        let visit = |found: &mut Self, open: &mut Vec<[i64; 2]>, pixel: [i64; 2]| {
            if let Some(index) = self.index(pixel)
                && self.set[index]
                && !found.set[index]
                && keep(pixel)
            {
                found.set[index] = true;
                open.push(pixel);
            }
        };
        visit(&mut found, &mut open, seed);
        while let Some([x, y]) = open.pop() {
            for j in y - 1..=y + 1 {
                for i in x - 1..=x + 1 {
                    visit(&mut found, &mut open, [i, j]);
                }
            }
        }
        found
    }

    /// The squares of `cell` x `cell` pixels that hold any of the set, as the pixels of a smaller
    /// image.
    pub fn in_cells(&self, cell: i64) -> Self {
        let (low, high) = self.window();
        let low = low.map(|x| x / cell);
        let size: [i64; 2] = std::array::from_fn(|k| high[k] / cell - low[k] + 1);
        let mut cells = Self {
            image: self.image.map(|side| (side + cell - 1) / cell),
            low,
            size,
            set: vec![false; (size[0] * size[1]) as usize],
        };
        self.pixels()
            .for_each(|pixel| cells.add(pixel.map(|x| x / cell)));
        cells
    }

    /// The pixels of the set with `keep`.
    pub fn kept(&self, keep: impl Fn([i64; 2]) -> bool) -> Self {
        let mut found = self.empty();
        self.pixels()
            .filter(|pixel| keep(*pixel))
            .for_each(|pixel| found.add(pixel));
        found
    }

    /// A set of no pixels in the same window.
    fn empty(&self) -> Self {
        Self {
            set: vec![false; self.set.len()],
            ..*self
        }
    }

    /// Takes the pixels of another set out of this one.
    pub fn remove(&mut self, other: &Self) {
        for index in 0..self.set.len() {
            self.set[index] &= !other.is_at(self.pixel(index));
        }
    }

    /// Adds a pixel of the window.
    pub fn add(&mut self, pixel: [i64; 2]) {
        if let Some(index) = self.index(pixel) {
            self.set[index] = true;
        }
    }

    /// How many pixels there are.
    pub fn count(&self) -> usize {
        self.set.iter().filter(|is| **is).count()
    }

    /// The pixels, row by row.
    pub fn pixels(&self) -> impl Iterator<Item = [i64; 2]> {
        (0..self.set.len())
            .filter(|index| self.set[*index])
            .map(|index| self.pixel(index))
    }

    /// Whether the set holds a pixel; for one beyond the image, whether it holds the nearest one
    /// inside.
    pub fn holds(&self, [x, y]: [i64; 2]) -> bool {
        self.is_at([x.clamp(0, self.image[0] - 1), y.clamp(0, self.image[1] - 1)])
    }

    /// Width and height of the image.
    pub fn image(&self) -> [i64; 2] {
        self.image
    }

    /// First and last column and row of the window.
    pub fn window(&self) -> ([i64; 2], [i64; 2]) {
        let last = std::array::from_fn(|k| self.low[k] + self.size[k] - 1);
        (self.low, last)
    }

    /// The same set in its smallest window.
    pub fn tight(&self) -> Self {
        let (mut low, mut high) = ([i64::MAX; 2], [i64::MIN; 2]);
        for pixel in self.pixels() {
            for k in 0..2 {
                low[k] = low[k].min(pixel[k]);
                high[k] = high[k].max(pixel[k]);
            }
        }
        let size: [i64; 2] = std::array::from_fn(|k| (high[k].saturating_sub(low[k]) + 1).max(0));
        let mut tight = Self {
            image: self.image,
            low,
            size,
            set: vec![false; (size[0] * size[1]) as usize],
        };
        self.pixels().for_each(|pixel| tight.add(pixel));
        tight
    }

    /// The pixel furthest from what the set does not hold, and how far: in steps to any of eight
    /// neighbours.
    pub fn deepest(&self) -> Option<([i64; 2], i64)> {
        let [width, height] = self.size;
        let mut depth = vec![0i64; self.set.len()];
        let at = |depth: &[i64], i: i64, j: i64| {
            if (0..width).contains(&i) && (0..height).contains(&j) {
                depth[(j * width + i) as usize]
            } else {
                0
            }
        };
        let ahead = [[-1, -1], [0, -1], [1, -1], [-1, 0]];
        for index in 0..self.set.len() {
            let (i, j) = (index as i64 % width, index as i64 / width);
            if self.set[index] {
                let least = ahead.iter().map(|[x, y]| at(&depth, i + x, j + y)).min();
                depth[index] = least.unwrap_or(0) + 1;
            }
        }
        for index in (0..self.set.len()).rev() {
            let (i, j) = (index as i64 % width, index as i64 / width);
            if self.set[index] {
                let least = ahead.iter().map(|[x, y]| at(&depth, i - x, j - y)).min();
                depth[index] = depth[index].min(least.unwrap_or(0) + 1);
            }
        }
        // The first of the deepest.
        let most = depth.iter().copied().max().filter(|depth| *depth > 0)?;
        let index = depth.iter().position(|depth| *depth == most)?;
        Some((self.pixel(index), most))
    }

    fn is_at(&self, pixel: [i64; 2]) -> bool {
        self.index(pixel).is_some_and(|index| self.set[index])
    }

    fn pixel(&self, index: usize) -> [i64; 2] {
        let index = index as i64;
        [
            self.low[0] + index % self.size[0],
            self.low[1] + index / self.size[0],
        ]
    }

    fn index(&self, [x, y]: [i64; 2]) -> Option<usize> {
        let (i, j) = (x - self.low[0], y - self.low[1]);
        let inside = (0..self.size[0]).contains(&i) && (0..self.size[1]).contains(&j);
        inside.then_some((j * self.size[0] + i) as usize)
    }
}
