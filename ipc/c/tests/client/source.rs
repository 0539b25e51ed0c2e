//! What the sources of `ipc` declare: messages with their fields, enumerations with their codes. One reading for both
//! languages.

use std::path::{Path, PathBuf};

use syn::parse::{Parse, ParseStream};
use syn::{
    Attribute, Expr, ExprLit, Fields, Ident, ImplItem, Item, Lit, LitInt, LitStr, Meta, Token, Type,
};

/// The sources that declare what travels.
const FILES: [&str; 6] = [
    "message.rs",
    "features.rs",
    "twist.rs",
    "robot.rs",
    "cycle.rs",
    "operator.rs",
];

/// A number, or what it is an array of and how many.
#[derive(Debug)]
pub enum Kind {
    /// A type by its name in Rust.
    Plain(String),
    /// An array.
    Array(String, usize),
}

/// A field of a message.
#[derive(Debug)]
pub struct Field {
    pub name: String,
    pub docs: Vec<String>,
    pub kind: Kind,
}

/// A message.
#[derive(Debug)]
pub struct Message {
    pub name: String,
    /// The name that iceoryx2 compares.
    pub type_name: String,
    pub docs: Vec<String>,
    pub fields: Vec<Field>,
}

/// An enumeration that travels as `u32`.
#[derive(Debug)]
pub struct Codes {
    pub name: String,
    pub docs: Vec<String>,
    /// Name, number, words, documentation.
    pub values: Vec<(String, u32, String, Vec<String>)>,
}

/// Bits that travel as a sum.
#[derive(Debug)]
pub struct Bits {
    pub name: String,
    /// Name, bit, documentation.
    pub values: Vec<(String, u32, Vec<String>)>,
}

/// All of it, in the order of the files.
#[derive(Debug, Default)]
pub struct Source {
    pub messages: Vec<Message>,
    pub codes: Vec<Codes>,
    pub bits: Vec<Bits>,
}

/// The root of the repository.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Reads the sources.
pub fn read() -> Source {
    let mut source = Source::default();
    for file in FILES {
        let path = root().join("ipc/src").join(file);
        let text = std::fs::read_to_string(&path).unwrap();
        for item in syn::parse_file(&text).unwrap().items {
            match item {
                Item::Struct(item) => source.messages.extend(message(&item)),
                Item::Impl(item) if item.trait_.is_none() => source.bits.extend(bits(&item)),
                Item::Macro(item) if item.mac.path.is_ident("codes") => {
                    source.codes.push(item.mac.parse_body().unwrap());
                }
                _ => (),
            }
        }
    }
    source
}

/// The message that a struct declares, where it is one.
fn message(item: &syn::ItemStruct) -> Option<Message> {
    let named = |attribute: &&Attribute| attribute.path().is_ident("type_name");
    let type_name: LitStr = item.attrs.iter().find(named)?.parse_args().unwrap();
    let Fields::Named(fields) = &item.fields else {
        panic!("{}: no names of fields", item.ident);
    };
    let field = |field: &syn::Field| Field {
        name: field.ident.as_ref().unwrap().to_string(),
        docs: docs(&field.attrs),
        kind: kind(&field.ty),
    };
    Some(Message {
        name: item.ident.to_string(),
        type_name: type_name.value(),
        docs: docs(&item.attrs),
        fields: fields.named.iter().map(field).collect(),
    })
}

/// The bits that an `impl` declares: constants `Self(1 << n)`.
fn bits(item: &syn::ItemImpl) -> Option<Bits> {
    let values = item.items.iter().filter_map(|item| match item {
        ImplItem::Const(constant) => match &constant.expr {
            Expr::Call(call) => {
                let bit = number(call.args.first()?);
                Some((constant.ident.to_string(), bit, docs(&constant.attrs)))
            }
            _ => None,
        },
        _ => None,
    });
    let values: Vec<_> = values.collect();
    let Kind::Plain(name) = kind(&item.self_ty) else {
        return None;
    };
    (!values.is_empty()).then_some(Bits { name, values })
}

/// A number, or one shifted.
fn number(expression: &Expr) -> u32 {
    match expression {
        Expr::Lit(ExprLit {
            lit: Lit::Int(number),
            ..
        }) => number.base10_parse().unwrap(),
        Expr::Binary(shift) if matches!(shift.op, syn::BinOp::Shl(_)) => {
            number(&shift.left) << number(&shift.right)
        }
        _ => panic!("a bit is neither a number nor one shifted"),
    }
}

fn kind(ty: &Type) -> Kind {
    let plain = |ty: &Type| match ty {
        Type::Path(path) => path.path.get_ident().unwrap().to_string(),
        _ => panic!("a field is neither a number nor a struct nor an array"),
    };
    match ty {
        Type::Array(array) => Kind::Array(plain(&array.elem), length(&array.len)),
        _ => Kind::Plain(plain(ty)),
    }
}

/// Lengths are numbers, `MAX_POINTS`, or products of them.
fn length(expression: &Expr) -> usize {
    match expression {
        Expr::Lit(ExprLit {
            lit: Lit::Int(number),
            ..
        }) => number.base10_parse().unwrap(),
        Expr::Path(path) if path.path.is_ident("MAX_POINTS") => ipc::MAX_POINTS,
        Expr::Binary(product) if matches!(product.op, syn::BinOp::Mul(_)) => {
            length(&product.left) * length(&product.right)
        }
        _ => panic!("the length of an array is neither a number nor a product"),
    }
}

/// Documentation, line by line, without the links of rustdoc.
fn docs(attributes: &[Attribute]) -> Vec<String> {
    let text = |attribute: &Attribute| match &attribute.meta {
        Meta::NameValue(pair) if pair.path.is_ident("doc") => match &pair.value {
            Expr::Lit(ExprLit {
                lit: Lit::Str(text),
                ..
            }) => Some(text.value()),
            _ => None,
        },
        _ => None,
    };
    let plain = |text: String| text.replace("[`", "`").replace("`]", "`");
    let plain = |text: String| plain(text).replace("crate::", "").trim().to_owned();
    attributes.iter().filter_map(text).map(plain).collect()
}

/// The body of the macro `codes!`.
impl Parse for Codes {
    fn parse(input: ParseStream) -> syn::Result<Self> {
        let docs = docs(&input.call(Attribute::parse_outer)?);
        let name = input.parse::<Ident>()?.to_string();
        let body;
        syn::braced!(body in input);
        let mut values = Vec::new();
        while !body.is_empty() {
            let docs = self::docs(&body.call(Attribute::parse_outer)?);
            let variant = body.parse::<Ident>()?.to_string();
            body.parse::<Token![=]>()?;
            let code = body.parse::<LitInt>()?.base10_parse()?;
            body.parse::<Token![=>]>()?;
            let words = body.parse::<LitStr>()?.value();
            body.parse::<Token![,]>()?;
            values.push((variant, code, words, docs));
        }
        Ok(Self { name, docs, values })
    }
}

/// `RobotState` as `robot_state`.
pub fn snake(name: &str) -> String {
    let mut snake = String::new();
    for letter in name.chars() {
        if letter.is_uppercase() && !snake.is_empty() {
            snake.push('_');
        }
        snake.extend(letter.to_lowercase());
    }
    snake
}
