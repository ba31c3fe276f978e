//! Reads the sources of the crate and resolves every path in them.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
};

use proc_macro2::{TokenStream, TokenTree};
use syn::{
    Attribute, Item, UseTree,
    visit::{self, Visit},
};

/// Path of a module or an item from the root of the crate: `["diagnose", "text"]`.
pub(crate) type Name = Vec<String>;

#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Target {
    /// An item of this crate: its file and its name.
    Item(Name, String),
    Module(Name),
    /// An item of another crate: its whole path.
    Foreign(Name),
}

#[derive(Debug, Default)]
pub(crate) struct File {
    /// Path below `src`.
    pub(crate) path: PathBuf,
    /// Names of the defined items.
    items: BTreeSet<String>,
    /// Path of each imported name.
    imports: BTreeMap<String, Name>,
    /// Modules of `use path::*`.
    globs: Vec<Name>,
    /// Paths in imports and in code, without re-exports (`pub use`).
    mentions: BTreeSet<Name>,
}

/// All files of a crate by module.
#[derive(Debug, Default)]
pub(crate) struct Sources {
    pub(crate) files: BTreeMap<Name, File>,
}

impl Sources {
    /// Reads every file below `src`, except the programs in `bin` and the modules for tests.
    pub(crate) fn read(src: &Path) -> Self {
        let mut sources = Self::default();
        sources.read_folder(src, src);
        sources
    }

    fn read_folder(&mut self, src: &Path, folder: &Path) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() && !path.ends_with("bin") {
                self.read_folder(src, &path);
            } else if path.extension().is_some_and(|ext| ext == "rs") && !path.ends_with("tests.rs") {
                let place = path.strip_prefix(src).unwrap();
                self.add(place, &fs::read_to_string(&path).unwrap());
            }
        }
    }

    /// Adds a file with its path below `src`.
    pub(crate) fn add(&mut self, place: &Path, text: &str) {
        let mut module: Name =
            place.with_extension("").iter().map(|part| part.to_string_lossy().into_owned()).collect();
        if module.last().is_some_and(|last| last == "mod" || last == "lib") {
            module.pop();
        }
        let mut file = File { path: place.to_owned(), ..File::default() };
        Reader(&mut file).visit_file(&syn::parse_file(text).unwrap());
        self.files.insert(module, file);
    }

    /// Targets of all paths in the file of `module`.
    pub(crate) fn targets(&self, module: &[String]) -> BTreeSet<Target> {
        self.files[module].mentions.iter().filter_map(|path| self.resolve(module, path, 0)).collect()
    }

    fn resolve(&self, from: &[String], path: &[String], depth: u32) -> Option<Target> {
        let (first, rest) = path.split_first()?;
        // A cycle of aliases has no target.
        if depth > 16 {
            return None;
        }
        match first.as_str() {
            "crate" => self.walk(&[], rest, depth),
            "self" => self.walk(from, rest, depth),
            "super" => self.walk(&from[..from.len().saturating_sub(1)], rest, depth),
            "Self" => None,
            _ => {
                let local = self.walk(from, path, depth);
                local.or_else(|| (path.len() > 1).then(|| Target::Foreign(path.to_vec())))
            }
        }
    }

    /// Resolves `path` from the module `from`.
    fn walk(&self, from: &[String], path: &[String], depth: u32) -> Option<Target> {
        let Some((first, rest)) = path.split_first() else {
            return Some(Target::Module(from.to_vec()));
        };
        if first == "super" {
            return self.walk(&from[..from.len().saturating_sub(1)], rest, depth);
        }
        let child: Name = from.iter().chain([first]).cloned().collect();
        if self.files.contains_key(&child) {
            return self.walk(&child, rest, depth);
        }
        let file = self.files.get(from)?;
        if file.items.contains(first) {
            return Some(Target::Item(from.to_vec(), first.clone()));
        }
        if let Some(alias) = file.imports.get(first) {
            let whole: Name = alias.iter().chain(rest).cloned().collect();
            return self.resolve(from, &whole, depth + 1);
        }
        file.globs.iter().find_map(|glob| {
            let whole: Name = glob.iter().chain(path).cloned().collect();
            self.resolve(from, &whole, depth + 1).filter(|target| !matches!(target, Target::Foreign(_)))
        })
    }
}

/// Collects the items, imports and paths of one file.
struct Reader<'a>(&'a mut File);

impl Reader<'_> {
    fn add_use(&mut self, tree: &UseTree, before: &[String], imports: bool) {
        let join = |name: String| before.iter().cloned().chain([name]).collect::<Name>();
        match tree {
            UseTree::Path(path) => self.add_use(&path.tree, &join(path.ident.to_string()), imports),
            UseTree::Group(group) => group.items.iter().for_each(|tree| self.add_use(tree, before, imports)),
            UseTree::Glob(_) => self.0.globs.push(before.to_vec()),
            UseTree::Name(leaf) if leaf.ident == "self" => self.add_import(before.last(), before, imports),
            UseTree::Name(leaf) => {
                self.add_import(Some(&leaf.ident.to_string()), &join(leaf.ident.to_string()), imports);
            }
            UseTree::Rename(leaf) => {
                self.add_import(Some(&leaf.rename.to_string()), &join(leaf.ident.to_string()), imports);
            }
        }
    }

    fn add_import(&mut self, name: Option<&String>, path: &[String], imports: bool) {
        // `use name;` imports a crate; an entry for it would refer to itself.
        if let (Some(name), true) = (name, path.len() > 1) {
            self.0.imports.insert(name.clone(), path.to_vec());
        }
        if imports {
            self.0.mentions.insert(path.to_vec());
        }
    }

    /// Paths in the arguments of a macro, which are not parsed: identifiers joined by `::`.
    fn add_tokens(&mut self, tokens: TokenStream) {
        let mut path = Name::new();
        let mut colons = 0;
        for token in tokens {
            match token {
                TokenTree::Ident(ident) => {
                    if colons != 2 {
                        self.add_path(&path);
                        path.clear();
                    }
                    path.push(ident.to_string());
                    colons = 0;
                }
                TokenTree::Punct(punct) if punct.as_char() == ':' => colons += 1,
                other => {
                    self.add_path(&path);
                    path.clear();
                    colons = 0;
                    if let TokenTree::Group(group) = other {
                        self.add_tokens(group.stream());
                    }
                }
            }
        }
        self.add_path(&path);
    }

    fn add_path(&mut self, path: &[String]) {
        if path.len() > 1 {
            self.0.mentions.insert(path.to_vec());
        }
    }
}

fn is_test(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        attribute.path().is_ident("cfg") && attribute.parse_args::<syn::Path>().is_ok_and(|path| path.is_ident("test"))
    })
}

impl<'ast> Visit<'ast> for Reader<'_> {
    fn visit_item(&mut self, item: &'ast Item) {
        let (attributes, name) = match item {
            Item::Const(item) => (&item.attrs, Some(&item.ident)),
            Item::Enum(item) => (&item.attrs, Some(&item.ident)),
            Item::Fn(item) => (&item.attrs, Some(&item.sig.ident)),
            Item::Macro(item) => (&item.attrs, item.ident.as_ref()),
            Item::Static(item) => (&item.attrs, Some(&item.ident)),
            Item::Struct(item) => (&item.attrs, Some(&item.ident)),
            Item::Trait(item) => (&item.attrs, Some(&item.ident)),
            Item::Type(item) => (&item.attrs, Some(&item.ident)),
            Item::Union(item) => (&item.attrs, Some(&item.ident)),
            Item::Impl(item) => (&item.attrs, None),
            Item::Mod(item) => (&item.attrs, None),
            Item::Use(item) => (&item.attrs, None),
            _ => return visit::visit_item(self, item),
        };
        if is_test(attributes) {
            return;
        }
        if let Some(name) = name {
            self.0.items.insert(name.to_string());
        }
        visit::visit_item(self, item);
    }

    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        self.add_use(&item.tree, &[], matches!(item.vis, syn::Visibility::Inherited));
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        self.add_path(&path.segments.iter().map(|segment| segment.ident.to_string()).collect::<Name>());
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, call: &'ast syn::Macro) {
        // `settings!` defines a struct.
        let tokens: Vec<String> = call.tokens.clone().into_iter().map(|token| token.to_string()).collect();
        if call.path.is_ident("settings")
            && let Some(at) = tokens.iter().position(|token| token == "struct")
        {
            self.0.items.insert(tokens[at + 1].clone());
        }
        self.add_tokens(call.tokens.clone());
        visit::visit_macro(self, call);
    }
}
