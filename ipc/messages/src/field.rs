//! Structs on the wire. The macro `wire!` lists the fields of each once and derives from the list
//! the `repr(C)` struct, its default, the check that it has no padding, and the table
//! [`Wire::FIELDS`].

use crate::codes::Table;

/// One field of a struct on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Field {
    /// Name in all languages.
    pub name: &'static str,
    /// Documentation, a line each, without the unit.
    pub doc: &'static str,
    /// Unit of the numbers; empty if they have none.
    pub unit: &'static str,
    /// Type of one element.
    pub kind: Kind,
    /// Elements: 1, or the length of an array.
    pub count: usize,
    /// Bytes before it.
    pub offset: usize,
    /// Bytes in it.
    pub size: usize,
    /// The meaning of the numbers, and which are valid.
    pub meaning: Meaning,
}

/// The meaning of a field's numbers. A message with other numbers is refused on reception.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Meaning {
    /// Any number.
    Any,
    /// Finite numbers.
    Finite,
    /// Pairs, of which as many are finite as the last field with a range says.
    FinitePairs,
    /// A count from `.0` to `.1`, both included.
    Range(u32, u32),
    /// A code of the table.
    Code(&'static Table),
    /// A code of the table; others are received all the same, because they are answered.
    AnyCode(&'static Table),
    /// A sum of the table's bits.
    Bits(&'static Table),
}

impl Meaning {
    /// Whether this integer is valid.
    pub fn allows(&self, number: u32) -> bool {
        match self {
            Self::Range(least, most) => (*least..=*most).contains(&number),
            Self::Code(table) | Self::AnyCode(table) => table.get(number).is_some(),
            Self::Any | Self::Finite | Self::FinitePairs | Self::Bits(_) => true,
        }
    }

    /// The names of the numbers.
    pub fn table(&self) -> Option<&'static Table> {
        match self {
            Self::Code(table) | Self::AnyCode(table) | Self::Bits(table) => Some(table),
            Self::Any | Self::Finite | Self::FinitePairs | Self::Range(..) => None,
        }
    }
}

mod sealed {
    /// Implemented by `wire!` alone: the transport relies on what the macro checks.
    pub trait Sealed {}
}
pub(crate) use sealed::Sealed;

/// A struct on the wire: plain `repr(C)` data without padding, pointers or references. Only this
/// crate implements it.
pub trait Wire: Sealed + Copy + Default + 'static {
    /// Name in Rust.
    const NAME: &'static str;
    /// Name that iceoryx2 compares: `vpc/`, [`Wire::NAME`], `/`, and a hash of the layout in
    /// hexadecimal digits. Builds with other fields therefore refuse each other.
    const TYPE_NAME: &'static str;
    /// Documentation, a line each.
    const DOC: &'static str;
    /// The fields, in order.
    const FIELDS: &'static [Field];

    /// Each field with its values.
    fn fields(&self) -> impl Iterator<Item = (&'static Field, Values<'_>)>;

    /// Each field with its values, to be changed.
    fn fields_mut(&mut self) -> impl Iterator<Item = (&'static Field, ValuesMut<'_>)>;
}

/// Digits of a layout in a type name.
pub(crate) const DIGITS: usize = 8;

/// `name`, then the layout of these fields in hexadecimal digits.
pub(crate) const fn type_name<const N: usize>(name: &str, fields: &[Field]) -> [u8; N] {
    let (mut text, layout) = ([0; N], layout(fields));
    let mut i = 0;
    while i < N {
        text[i] = match N - i {
            behind @ ..=DIGITS => b"0123456789abcdef"[(layout >> (4 * (behind - 1))) as usize % 16],
            _ => name.as_bytes()[i],
        };
        i += 1;
    }
    text
}

/// Text that is ASCII.
pub(crate) const fn text(ascii: &[u8]) -> &str {
    match core::str::from_utf8(ascii) {
        Ok(text) => text,
        Err(_) => panic!("no text"),
    }
}

/// A hash of what readers of the fields rely on: names, units, kinds, counts and offsets, in order.
const fn layout(fields: &[Field]) -> u32 {
    let mut hash = 0x811c_9dc5;
    let mut i = 0;
    while i < fields.len() {
        let Field {
            name,
            unit,
            kind,
            count,
            offset,
            ..
        } = fields[i];
        hash = hashed(hash, name.as_bytes());
        hash = hashed(hash, &[kind as u8]);
        hash = hashed(hash, unit.as_bytes());
        hash = hashed(hash, &(count as u32).to_le_bytes());
        hash = hashed(hash, &(offset as u32).to_le_bytes());
        if let Kind::Stamp = kind {
            hash = hashed(hash, &layout(Stamp::FIELDS).to_le_bytes());
        }
        i += 1;
    }
    hash
}

/// FNV-1a: `hash` after these bytes.
const fn hashed(mut hash: u32, bytes: &[u8]) -> u32 {
    let mut i = 0;
    while i < bytes.len() {
        hash = (hash ^ bytes[i] as u32).wrapping_mul(0x0100_0193);
        i += 1;
    }
    hash
}

/// What is known of a struct on the wire.
#[derive(Clone, Copy, Debug)]
#[allow(missing_docs)]
pub struct Struct {
    pub name: &'static str,
    pub type_name: &'static str,
    pub doc: &'static str,
    pub size: usize,
    pub fields: &'static [Field],
}

impl Struct {
    /// That of `T`.
    pub const fn of<T: Wire>() -> Self {
        Self {
            name: T::NAME,
            type_name: T::TYPE_NAME,
            doc: T::DOC,
            size: size_of::<T>(),
            fields: T::FIELDS,
        }
    }
}

/// A type that a field may have.
pub trait FieldType: Copy {
    /// Type of one element.
    const KIND: Kind;
    /// Elements.
    const COUNT: usize;
    /// The default.
    const ZERO: Self;

    /// The elements.
    fn values(&self) -> Values<'_>;

    /// The elements, to be changed.
    fn values_mut(&mut self) -> ValuesMut<'_>;
}

macro_rules! kinds {
    ($($number:ident $kind:ident $zero:literal,)+) => {
        /// Type of the elements of a field.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[allow(missing_docs)]
        pub enum Kind {
            $($kind,)+
            Stamp,
        }

        /// The elements of a field: one, or those of an array.
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[allow(missing_docs)]
        pub enum Values<'a> {
            $($kind(&'a [$number]),)+
            Stamp(&'a Stamp),
        }

        /// As [`Values`], to be changed.
        #[derive(Debug)]
        #[allow(missing_docs)]
        pub enum ValuesMut<'a> {
            $($kind(&'a mut [$number]),)+
            Stamp(&'a mut Stamp),
        }

        $(
            impl FieldType for $number {
                const KIND: Kind = Kind::$kind;
                const COUNT: usize = 1;
                const ZERO: Self = $zero;

                fn values(&self) -> Values<'_> {
                    Values::$kind(core::slice::from_ref(self))
                }

                fn values_mut(&mut self) -> ValuesMut<'_> {
                    ValuesMut::$kind(core::slice::from_mut(self))
                }
            }

            impl<const N: usize> FieldType for [$number; N] {
                const KIND: Kind = Kind::$kind;
                const COUNT: usize = N;
                const ZERO: Self = [$zero; N];

                fn values(&self) -> Values<'_> {
                    Values::$kind(self)
                }

                fn values_mut(&mut self) -> ValuesMut<'_> {
                    ValuesMut::$kind(self)
                }
            }
        )+
    };
}

kinds! {
    u8 U8 0,
    u32 U32 0,
    u64 U64 0,
    i64 I64 0,
    f64 F64 0.0,
}

impl FieldType for Stamp {
    const KIND: Kind = Kind::Stamp;
    const COUNT: usize = 1;
    const ZERO: Self = Self {
        sequence: 0,
        published_ns: 0,
        data_ns: 0,
    };

    fn values(&self) -> Values<'_> {
        Values::Stamp(self)
    }

    fn values_mut(&mut self) -> ValuesMut<'_> {
        ValuesMut::Stamp(self)
    }
}

/// Declares a struct on the wire: `name: type [unit meaning] = default`, the last two only where
/// needed.
///
/// Meanings: `finite`, `finite_pairs`, `range(least, most)`, `code(Type)`, `any_code(Type)`,
/// `bits(Type)`.
macro_rules! wire {
    ($(#[doc = $doc:expr])+ $(#[derive($($derive:path),+)])? $name:ident {
        $(
            $(#[doc = $field_doc:literal])+
            $field:ident: $type:ty
                $([$($unit:literal)? $($meaning:ident $(($($argument:tt)+))?)?])?
                $(= $default:expr)?,
        )+
    }) => {
        $(#[doc = $doc])+
        #[repr(C)]
        #[derive(Clone, Copy, Debug, PartialEq $(, $($derive),+)?)]
        pub struct $name {
            $(
                $(#[doc = $field_doc])+
                $($(#[doc = concat!(" Unit: ", $unit, ".")])?)?
                pub $field: $type,
            )+
        }

        const _: () = assert!(
            size_of::<$name>() == 0 $(+ size_of::<$type>())+,
            concat!(stringify!($name), " has padding: add or move a field of 4 bytes"),
        );

        impl $crate::field::Sealed for $name {}

        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $crate::field::wire!(@default $type $(, $default)?),)+ }
            }
        }

        impl $crate::field::Wire for $name {
            const NAME: &'static str = stringify!($name);
            const TYPE_NAME: &'static str = {
                const NAME: &str = concat!("vpc/", stringify!($name), "/");
                const TYPE_NAME: [u8; NAME.len() + $crate::field::DIGITS] =
                    $crate::field::type_name(NAME, <$name as $crate::field::Wire>::FIELDS);
                $crate::field::text(&TYPE_NAME)
            };
            const DOC: &'static str = concat!($($doc, "\n"),+);
            const FIELDS: &'static [$crate::field::Field] = &[$($crate::field::Field {
                name: stringify!($field),
                doc: concat!($($field_doc, "\n"),+),
                unit: concat!($($($unit)?)?),
                kind: <$type as $crate::field::FieldType>::KIND,
                count: <$type as $crate::field::FieldType>::COUNT,
                offset: core::mem::offset_of!($name, $field),
                size: size_of::<$type>(),
                meaning: $crate::field::wire!(@meaning $($($meaning $(($($argument)+))?)?)?),
            },)+];

            fn fields(
                &self,
            ) -> impl Iterator<Item = (&'static $crate::field::Field, $crate::field::Values<'_>)> {
                let values = [$($crate::field::FieldType::values(&self.$field),)+];
                Self::FIELDS.iter().zip(values)
            }

            fn fields_mut(
                &mut self,
            ) -> impl Iterator<Item = (&'static $crate::field::Field, $crate::field::ValuesMut<'_>)> {
                let values = [$($crate::field::FieldType::values_mut(&mut self.$field),)+];
                Self::FIELDS.iter().zip(values)
            }
        }
    };
    (@default $type:ty) => { <$type as $crate::field::FieldType>::ZERO };
    (@default $type:ty, $value:expr) => { $value };
    (@meaning) => { $crate::field::Meaning::Any };
    (@meaning finite) => { $crate::field::Meaning::Finite };
    (@meaning finite_pairs) => { $crate::field::Meaning::FinitePairs };
    (@meaning range($least:expr, $most:expr)) => {
        $crate::field::Meaning::Range($least as u32, $most as u32)
    };
    (@meaning code($codes:ty)) => { $crate::field::Meaning::Code(&<$codes>::TABLE) };
    (@meaning any_code($codes:ty)) => { $crate::field::Meaning::AnyCode(&<$codes>::TABLE) };
    (@meaning bits($bits:ty)) => { $crate::field::Meaning::Bits(&<$bits>::TABLE) };
}
pub(crate) use wire;

wire! {
    /// Head of every message. Times are CLOCK_MONOTONIC.
    #[derive(Eq, serde::Serialize, serde::Deserialize)]
    Stamp {
        /// Number of the message. Each publisher counts from 1, and starts again from 1 when it
        /// restarts.
        sequence: u64,
        /// When the message was published.
        published_ns: u64 ["ns"],
        /// The instant that the data describe; for features the middle of the exposure.
        data_ns: u64 ["ns"],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::CycleRecord;

    #[test]
    fn each_change_of_a_field_changes_the_layout() {
        let same = layout(CycleRecord::FIELDS);
        let changed = |change: fn(&mut Field)| {
            let mut fields = CycleRecord::FIELDS.to_vec();
            change(&mut fields[7]);
            layout(&fields) != same
        };
        assert!(!changed(|_| ()));
        assert!(!changed(|field| field.doc = "Other words."));
        assert!(changed(|field| field.name = "late_ns"));
        assert!(changed(|field| field.unit = "us"));
        assert!(changed(|field| field.kind = Kind::I64));
        assert!(changed(|field| field.count = 2));
        assert!(changed(|field| field.offset += 8));
        let mut swapped = CycleRecord::FIELDS.to_vec();
        swapped.swap(7, 8);
        assert_ne!(layout(&swapped), same);
        assert_ne!(layout(&swapped[1..]), layout(&swapped));
    }

    #[test]
    fn a_type_name_ends_in_the_layout() {
        let layout = layout(CycleRecord::FIELDS);
        let expected = format!("vpc/CycleRecord/{layout:08x}");
        assert_eq!(CycleRecord::TYPE_NAME, expected);
        let vectors: [(&[u8], u32); 2] = [(b"", 0x811c_9dc5), (b"foobar", 0xbf9c_f968)];
        for (bytes, hash) in vectors {
            assert_eq!(hashed(0x811c_9dc5, bytes), hash);
        }
    }
}
