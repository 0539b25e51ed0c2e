//! Structs as words of eight bytes, each with the name of its field: one walk over the fields serves writing, reading,
//! sealing, comparing, and the description in the file.

/// What the eight bytes of a word are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kind {
    /// An unsigned integer; codes and truth values too.
    #[default]
    Unsigned,
    /// A signed integer in two's complement.
    Signed,
    /// An IEEE 754 double.
    Real,
}

impl Kind {
    /// The name in files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Unsigned => "u64",
            Self::Signed => "i64",
            Self::Real => "f64",
        }
    }

    /// A word of this kind in JSON; a double that JSON has no number for as text.
    pub fn value(self, word: u64) -> serde_json::Value {
        match self {
            Self::Unsigned => word.into(),
            Self::Signed => (word as i64).into(),
            Self::Real if f64::from_bits(word).is_finite() => f64::from_bits(word).into(),
            Self::Real => self.show(word).into(),
        }
    }

    /// A word of this kind as a person reads it, exactly.
    pub fn show(self, word: u64) -> String {
        match self {
            Self::Unsigned => word.to_string(),
            Self::Signed => (word as i64).to_string(),
            Self::Real => format!("{:?}", f64::from_bits(word)),
        }
    }
}

/// Something that can be taken apart into words, and put together again by the same walk.
pub trait Words {
    /// Shows every field to `visit`, always the same ones in the same order, and takes over what it puts there.
    fn words<V: Visit>(&mut self, visit: &mut V);
}

/// Who walks over the fields.
pub trait Visit {
    /// One field: a number or an array of them.
    fn field(&mut self, name: &'static str, kind: Kind, words: &mut [u64]);

    /// The fields that follow belong to this part.
    fn enter(&mut self, _part: &'static str) {}

    /// The part ends.
    fn leave(&mut self) {}

    /// The word just put into the last field is none of its values.
    fn refuse(&mut self) {}

    /// A part with fields of its own.
    fn part(&mut self, name: &'static str, part: &mut impl Words)
    where
        Self: Sized,
    {
        self.enter(name);
        part.words(self);
        self.leave();
    }

    /// An unsigned integer.
    fn u64(&mut self, name: &'static str, value: &mut u64) {
        self.field(name, Kind::Unsigned, core::slice::from_mut(value));
    }

    /// An unsigned integer of 32 bits.
    fn u32(&mut self, name: &'static str, value: &mut u32) {
        let mut word = u64::from(*value);
        self.u64(name, &mut word);
        match u32::try_from(word) {
            Ok(narrow) => *value = narrow,
            Err(_) => self.refuse(),
        }
    }

    /// A signed integer.
    fn i64(&mut self, name: &'static str, value: &mut i64) {
        let mut word = *value as u64;
        self.field(name, Kind::Signed, core::slice::from_mut(&mut word));
        *value = word as i64;
    }

    /// An instant or a duration, 2^64 - 1 where there is none.
    fn option(&mut self, name: &'static str, value: &mut Option<u64>) {
        let mut word = value.unwrap_or(u64::MAX);
        self.u64(name, &mut word);
        *value = (word != u64::MAX).then_some(word);
    }

    /// A truth value: 0 or 1.
    fn flag(&mut self, name: &'static str, value: &mut bool) {
        let mut word = u64::from(*value);
        self.u64(name, &mut word);
        match word {
            0 | 1 => *value = word == 1,
            _ => self.refuse(),
        }
    }

    /// An array of doubles.
    fn reals(&mut self, name: &'static str, values: &mut [f64]) {
        self.field(name, Kind::Real, bytemuck::cast_slice_mut(values));
    }

    /// A double.
    fn real(&mut self, name: &'static str, value: &mut f64) {
        self.reals(name, core::slice::from_mut(value));
    }

    /// A value that travels as a number.
    fn code<T: Copy>(
        &mut self,
        name: &'static str,
        value: &mut T,
        code: fn(T) -> u32,
        from_code: fn(u32) -> Option<T>,
    ) {
        let mut word = u64::from(code(*value));
        self.u64(name, &mut word);
        match u32::try_from(word).ok().and_then(from_code) {
            Some(known) => *value = known,
            None => self.refuse(),
        }
    }
}

/// Sums words up so that a change of any single one, even of its last bit, changes the sum: each step is a bijection
/// of the sum so far and of the word.
#[derive(Clone, Copy, Debug)]
pub struct Seal(u64);

impl Seal {
    /// The sum over some words.
    pub fn of(something: &mut impl Words) -> u64 {
        let mut seal = Self(0x7670_6364_2066_6c74);
        something.words(&mut seal);
        seal.0
    }
}

impl Visit for Seal {
    fn field(&mut self, _name: &'static str, _kind: Kind, words: &mut [u64]) {
        for word in words {
            // The odd factor is 2^64 over the golden ratio.
            self.0 = (self.0.rotate_left(29) ^ *word).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        }
    }
}

/// Appends words to a list.
#[derive(Debug)]
pub struct Writer<'a>(pub &'a mut Vec<u64>);

impl Visit for Writer<'_> {
    fn field(&mut self, _name: &'static str, _kind: Kind, words: &mut [u64]) {
        self.0.extend_from_slice(words);
    }
}

/// Takes words from a list.
struct Reader<'a> {
    words: &'a [u64],
    at: usize,
    /// Index of the first word that is none of its field's values.
    refused: Option<usize>,
}

/// Fills something in with words, as many as it has.
///
/// # Errors
/// Index of the first word that is none of its field's values.
pub fn fill<T: Words>(mut blank: T, words: &[u64]) -> Result<T, usize> {
    let mut reader = Reader {
        words,
        at: 0,
        refused: None,
    };
    blank.words(&mut reader);
    reader.refused.map_or(Ok(blank), Err)
}

impl Visit for Reader<'_> {
    fn field(&mut self, _name: &'static str, _kind: Kind, words: &mut [u64]) {
        for (to, from) in words.iter_mut().zip(&self.words[self.at..]) {
            *to = *from;
        }
        self.at += words.len();
    }

    fn refuse(&mut self) {
        self.refused.get_or_insert(self.at - 1);
    }
}

/// A field as files describe it.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Field {
    /// Name with the parts that it belongs to: `inputs.features.points`.
    pub name: String,
    /// `u64`, `i64` or `f64`.
    pub kind: String,
    /// Numbers in it, from 1.
    pub count: usize,
}

/// Lists the fields.
#[derive(Debug, Default)]
pub struct Layout {
    parts: Vec<&'static str>,
    fields: Vec<Field>,
    kinds: Vec<Kind>,
}

impl Layout {
    /// The fields of something.
    pub fn of(something: &mut impl Words) -> Self {
        let mut layout = Self::default();
        something.words(&mut layout);
        layout
    }

    /// The fields, in order.
    pub fn fields(&self) -> &[Field] {
        &self.fields
    }

    /// Words in all.
    pub fn count(&self) -> usize {
        self.fields.iter().map(|field| field.count).sum()
    }

    /// Name of the word at an index, and what it is: `told.twist[3]`.
    pub fn word(&self, index: usize) -> Option<(String, Kind)> {
        let mut first = 0;
        for (field, kind) in self.fields.iter().zip(&self.kinds) {
            if index < first + field.count {
                let name = match field.count {
                    1 => field.name.clone(),
                    _ => format!("{}[{}]", field.name, index - first),
                };
                return Some((name, *kind));
            }
            first += field.count;
        }
        None
    }
}

impl Visit for Layout {
    fn field(&mut self, name: &'static str, kind: Kind, words: &mut [u64]) {
        let parts = self.parts.iter().chain([&name]).copied();
        self.fields.push(Field {
            name: parts.collect::<Vec<_>>().join("."),
            kind: kind.name().to_owned(),
            count: words.len(),
        });
        self.kinds.push(kind);
    }

    fn enter(&mut self, part: &'static str) {
        self.parts.push(part);
    }

    fn leave(&mut self) {
        self.parts.pop();
    }
}

/// The words of something.
pub fn words_of(something: &mut impl Words) -> Vec<u64> {
    let mut words = Vec::new();
    something.words(&mut Writer(&mut words));
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Clone, Debug, Default, PartialEq)]
    struct Sample {
        count: u32,
        sign: i64,
        good: bool,
        twist: [f64; 3],
    }

    impl Words for Sample {
        fn words<V: Visit>(&mut self, visit: &mut V) {
            visit.u32("count", &mut self.count);
            visit.enter("deep");
            visit.i64("sign", &mut self.sign);
            visit.flag("good", &mut self.good);
            visit.leave();
            visit.reals("twist", &mut self.twist);
        }
    }

    fn sample() -> Sample {
        Sample {
            count: 7,
            sign: -3,
            good: true,
            twist: [0.1, -0.0, f64::NAN],
        }
    }

    #[test]
    fn what_is_written_is_read_bit_for_bit() {
        let words = words_of(&mut sample());
        assert_eq!(words.len(), 6);
        let mut back = fill(Sample::default(), &words).unwrap();
        assert_eq!(words_of(&mut back), words);
    }

    #[test]
    fn a_word_that_is_no_value_of_its_field_is_refused_by_its_place() {
        let mut words = words_of(&mut sample());
        words[2] = 2;
        assert_eq!(fill(Sample::default(), &words), Err(2));
        words[2] = 1;
        words[0] = 1 << 40;
        assert_eq!(fill(Sample::default(), &words), Err(0));
    }

    #[test]
    fn a_layout_names_every_word() {
        let layout = Layout::of(&mut sample());
        assert_eq!(layout.count(), 6);
        let name = |index| layout.word(index).map(|(name, kind)| (name, kind.name()));
        assert_eq!(name(1), Some(("deep.sign".to_owned(), "i64")));
        assert_eq!(name(5), Some(("twist[2]".to_owned(), "f64")));
        assert_eq!(name(6), None);
    }

    #[test]
    fn the_last_bit_of_any_word_changes_the_seal() {
        let seal = Seal::of(&mut sample());
        let words = words_of(&mut sample());
        for k in 3..6 {
            let mut changed = sample();
            changed.twist[k - 3] = f64::from_bits(words[k] ^ 1);
            assert_ne!(Seal::of(&mut changed), seal, "{k}");
        }
        let mut changed = sample();
        changed.twist.swap(0, 1);
        assert_ne!(Seal::of(&mut changed), seal);
    }
}
