//! Numbers with names: enumerations and sums of bits that travel as `u32`.

use core::ffi::CStr;

/// One value of a [`Table`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Name {
    /// Its name in Rust: `NoFeatures`, `COMMAND_LIMITED`.
    pub name: &'static str,
    /// The number, or the bit as a number.
    pub number: u32,
    /// For people: `no features`.
    pub text: &'static str,
    /// The same for C.
    pub c_text: &'static CStr,
    /// Its documentation, a line each.
    pub doc: &'static str,
}

/// The values of an enumeration or of a sum of bits, in ascending order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Table {
    /// Name of the type in Rust.
    pub name: &'static str,
    /// Its documentation, a line each.
    pub doc: &'static str,
    /// The values.
    pub names: &'static [Name],
}

impl Table {
    /// The entry for a number.
    pub fn get(&self, number: u32) -> Option<&'static Name> {
        self.names.iter().find(|name| name.number == number)
    }
}

/// A text that ends in NUL, for C.
pub(crate) const fn c_text(text: &'static str) -> &'static CStr {
    match CStr::from_bytes_with_nul(text.as_bytes()) {
        Ok(text) => text,
        Err(_) => panic!("a text contains NUL"),
    }
}

/// The constant `TABLE` of codes or bits.
macro_rules! table {
    ($name:ident $doc:expr; $($value:ident $number:literal $text:literal $value_doc:expr,)+) => {
        /// Names and texts of all values.
        pub const TABLE: $crate::codes::Table = $crate::codes::Table {
            name: stringify!($name),
            doc: $doc,
            names: &[$($crate::codes::Name {
                name: stringify!($value),
                number: $number,
                text: $text,
                c_text: $crate::codes::c_text(concat!($text, "\0")),
                doc: $value_doc,
            }),+],
        };
    };
}
pub(crate) use table;

/// Declares an enumeration that travels as `u32`. A number from another process becomes a value by
/// `from_code`, and only if the contract knows it. `none` is the number for no value, where there
/// may be none.
macro_rules! codes {
    ($(#[doc = $doc:literal])+ $name:ident {
        $(none = $none:literal => $none_text:literal $none_doc:literal,)?
        $($(#[doc = $value_doc:literal])+ $value:ident = $code:literal => $text:literal,)+
    }) => {
        $(#[doc = $doc])+
        #[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
        #[repr(u32)]
        pub enum $name {
            $($(#[doc = $value_doc])+ $value = $code,)+
        }

        impl $name {
            $crate::codes::table! {
                $name concat!($($doc, "\n"),+);
                $(None $none $none_text concat!($none_doc, "\n"),)?
                $($value $code $text concat!($($value_doc, "\n"),+),)+
            }

            /// The number that travels.
            pub const fn code(self) -> u32 {
                self as u32
            }

            /// The value of a number; `None` if the contract does not know it.
            pub const fn from_code(code: u32) -> Option<Self> {
                match code {
                    $($code => Some(Self::$value),)+
                    _ => None,
                }
            }
        }

        impl core::fmt::Display for $name {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                f.write_str(match self {
                    $(Self::$value => $text,)+
                })
            }
        }
    };
}
pub(crate) use codes;

/// Declares a sum of bits that travels as `u32`.
macro_rules! bits {
    ($(#[doc = $doc:literal])+ $name:ident {
        $($(#[doc = $bit_doc:literal])+ $bit:ident = $value:literal => $text:literal,)+
    }) => {
        $(#[doc = $doc])+
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
        pub struct $name(pub u32);

        impl $name {
            $($(#[doc = $bit_doc])+ pub const $bit: Self = Self($value);)+

            $crate::codes::table! {
                $name concat!($($doc, "\n"),+);
                $($bit $value $text concat!($($bit_doc, "\n"),+),)+
            }

            /// The union of both.
            pub const fn with(self, bits: Self) -> Self {
                Self(self.0 | bits.0)
            }

            /// Whether all of these bits are set.
            pub const fn has(self, bits: Self) -> bool {
                self.0 & bits.0 == bits.0
            }

            /// Name and text of each bit that is set.
            pub fn names(self) -> impl Iterator<Item = &'static $crate::codes::Name> {
                let names = Self::TABLE.names.iter();
                names.filter(move |name| self.0 & name.number != 0)
            }

            /// Whether any of these bits is set.
            pub const fn any(self, bits: Self) -> bool {
                self.0 & bits.0 != 0
            }
        }
    };
}
pub(crate) use bits;
